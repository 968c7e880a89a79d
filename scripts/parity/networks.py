"""The six networks in PyTorch, written from their definition, with the released parameter names.

Images are N x C x H x W; `image_size` is the build size, `width` the channels of the first layer.
"""

import math

import torch
from torch import nn
from torch.nn import functional

NAMES = ("normal", "depth", "illumination", "illumination_decoder", "sss", "reconstruction")


class DoubleConv(nn.Module):
    def __init__(self, channels_in, channels_out, middle, norm):
        super().__init__()
        self.double_conv = nn.Sequential(
            nn.Conv2d(channels_in, middle, 3, padding=1), norm(middle), nn.ReLU(),
            nn.Conv2d(middle, channels_out, 3, padding=1), norm(channels_out), nn.ReLU())

    def forward(self, x):
        return self.double_conv(x)


class Down(nn.Module):
    def __init__(self, channels_in, channels_out):
        super().__init__()
        self.maxpool_conv = nn.Sequential(
            nn.MaxPool2d(2), DoubleConv(channels_in, channels_out, channels_out, nn.InstanceNorm2d))

    def forward(self, x):
        return self.maxpool_conv(x)


class Up(nn.Module):
    def __init__(self, channels_in, channels_out):
        super().__init__()
        self.up = nn.Upsample(scale_factor=2, mode="bilinear", align_corners=True)
        self.conv = DoubleConv(channels_in, channels_out, channels_in // 2, nn.BatchNorm2d)

    def forward(self, x, skip):
        return self.conv(torch.cat([skip, self.up(x)], dim=1))


class OutConv(nn.Module):
    def __init__(self, channels_in, channels_out):
        super().__init__()
        self.conv = nn.Conv2d(channels_in, channels_out, 1)

    def forward(self, x):
        return self.conv(x)


class Mlp(nn.Module):
    def __init__(self, channels, hidden):
        super().__init__()
        self.fc1 = nn.Linear(channels, hidden)
        self.fc2 = nn.Linear(hidden, channels)

    def forward(self, x):
        return self.fc2(functional.gelu(self.fc1(x)))


class Attention(nn.Module):
    def __init__(self, channels, heads=8):
        super().__init__()
        self.heads = heads
        self.query = nn.Linear(channels, channels)
        self.key = nn.Linear(channels, channels)
        self.value = nn.Linear(channels, channels)
        self.out = nn.Linear(channels, channels)

    def forward(self, x):
        batch, tokens, channels = x.shape
        depth = channels // self.heads

        def split(t):
            return t.view(batch, tokens, self.heads, depth).transpose(1, 2)

        scores = split(self.query(x)) @ split(self.key(x)).transpose(-1, -2) / math.sqrt(depth)
        mixed = torch.softmax(scores, dim=-1) @ split(self.value(x))
        return self.out(mixed.transpose(1, 2).reshape(batch, tokens, channels))


class TransformerBlock(nn.Module):
    def __init__(self, channels):
        super().__init__()
        self.attention_norm = nn.LayerNorm(channels, eps=1e-6)
        self.ffn_norm = nn.LayerNorm(channels, eps=1e-6)
        self.ffn = Mlp(channels, 4 * channels)
        self.attn = Attention(channels)

    def forward(self, x):
        x = x + self.attn(self.attention_norm(x))
        return x + self.ffn(self.ffn_norm(x))


class TransUnet(nn.Module):
    def __init__(self, channels_in, channels_out, width):
        super().__init__()
        w = width
        self.inc = DoubleConv(channels_in, w, w, nn.BatchNorm2d)
        self.down1 = Down(w, 2 * w)
        self.down2 = Down(2 * w, 4 * w)
        self.down3 = Down(4 * w, 8 * w)
        self.down4 = Down(8 * w, 8 * w)
        self.up1 = Up(16 * w, 4 * w)
        self.up2 = Up(8 * w, 2 * w)
        self.up3 = Up(4 * w, w)
        self.up4 = Up(2 * w, w)
        self.outc = OutConv(w, channels_out)
        self.resblock_layers = nn.ModuleList([TransformerBlock(8 * w) for _ in range(8)])

    def forward(self, x):
        x1 = self.inc(x)
        x2 = self.down1(x1)
        x3 = self.down2(x2)
        x4 = self.down3(x3)
        x5 = self.down4(x4)
        tokens = x5.flatten(2).transpose(1, 2)
        for block in self.resblock_layers:
            tokens = block(tokens)
        y = tokens.transpose(1, 2).reshape(x5.shape)
        for up, skip in ((self.up1, x4), (self.up2, x3), (self.up3, x2), (self.up4, x1)):
            y = up(y, skip)
        return self.outc(y)


def conv_norm_relu(conv, channels):
    return [conv, nn.BatchNorm2d(channels), nn.ReLU()]


def first_conv(channels_in, width):
    return [nn.ReflectionPad2d(3)] + conv_norm_relu(nn.Conv2d(channels_in, width, 7, bias=False), width)


def halving_conv(channels_in, channels_out):
    conv = nn.Conv2d(channels_in, channels_out, 3, stride=2, padding=1, bias=False)
    return conv_norm_relu(conv, channels_out)


class GridFlatten(nn.Module):
    """Flattens a map after averaging it to grid x grid positions (a no-op at the build size)."""

    def __init__(self, grid):
        super().__init__()
        self.grid = grid

    def forward(self, x):
        return functional.adaptive_avg_pool2d(x, self.grid).flatten(1)


class IlluminationEncoder(nn.Module):
    def __init__(self, channels_in, values, width, image_size):
        super().__init__()
        w, grid = width, image_size // 8
        self.model = nn.Sequential(
            *first_conv(channels_in, w), *halving_conv(w, 2 * w), *halving_conv(2 * w, 4 * w),
            *halving_conv(4 * w, 8 * w), GridFlatten(grid), nn.Linear(8 * w * grid * grid, values),
            nn.BatchNorm1d(values))

    def forward(self, x):
        return self.model(x)


class IlluminationDecoder(nn.Module):
    def __init__(self, values, width, image_size):
        super().__init__()
        channels = [c * width // 64 for c in (1024, 512, 256, 128, 64, 32, 16)] + [1]
        channels = channels[-math.ceil(math.log2(image_size)):]
        layers = []
        for channels_in, channels_out in zip([values] + channels[:-1], channels):
            conv = nn.ConvTranspose2d(channels_in, channels_out, 4, stride=2, padding=1, bias=False)
            layers += conv_norm_relu(conv, channels_out)
        layers[-1] = nn.Tanh()
        self.model = nn.Sequential(*layers)

    def forward(self, x):
        return self.model(x[:, :, None, None])


class ResidualBlock(nn.Module):
    def __init__(self, channels):
        super().__init__()
        layers = []
        for _ in range(2):
            layers += [nn.ReflectionPad2d(1)]
            layers += conv_norm_relu(nn.Conv2d(channels, channels, 3, bias=False), channels)
        self.conv_block = nn.Sequential(*layers[:-1])

    def forward(self, x):
        return x + self.conv_block(x)


class Model(nn.Module):
    def __init__(self, *layers):
        super().__init__()
        self.model = nn.Sequential(*layers)

    def forward(self, x):
        return self.model(x)


class SssNetwork(nn.Module):
    def __init__(self, channels_in, values, width, image_size):
        super().__init__()
        w, grid = width, image_size // 16
        self.feature_encoder = Model(
            *first_conv(channels_in, w), *halving_conv(w, 2 * w), *halving_conv(2 * w, 4 * w),
            *[ResidualBlock(4 * w) for _ in range(15)])
        self.scatter_encoder = Model(
            *halving_conv(4 * w, 2 * w), *halving_conv(2 * w, w), GridFlatten(grid),
            nn.Linear(w * grid * grid, values), nn.BatchNorm1d(values), nn.Tanh())

    def forward(self, x):
        return self.scatter_encoder(self.feature_encoder(x))


def sizes(variant, channels=None):
    """(network input channels, illumination values, SSS values)."""
    image, light, sss = (21, 27, 8) if variant == "release" else (19, 28, 7)
    return channels or image, light, sss


def make(name, width=64, image_size=256, variant="release", channels=None):
    image, light, sss = sizes(variant, channels)
    if name == "normal":
        return TransUnet(image, 3, width)
    if name == "depth":
        return TransUnet(image, 1, width)
    if name == "reconstruction":
        return TransUnet(12 + sss, 12, width)
    if name == "illumination":
        return IlluminationEncoder(image, light, width, image_size)
    if name == "illumination_decoder":
        return IlluminationDecoder(light, width, image_size)
    if name == "sss":
        return SssNetwork(5 + image, sss, width, image_size)
    raise ValueError(f"no network {name!r}; there are {', '.join(NAMES)}")


def input_shape(name, batch, size, variant="release", channels=None):
    image, light, sss = sizes(variant, channels)
    if name == "illumination_decoder":
        return batch, light
    count = {"reconstruction": 12 + sss, "sss": 5 + image}.get(name, image)
    return batch, count, size, size


def randomize(model, seed, width=64):
    """The recipe's initial weights, then perturbed: no scale is 1, no offset 0 and no statistic trivial.

    Narrow networks get larger weights: otherwise signals and gradients die out on the way in evaluation mode.
    """
    generator = torch.Generator().manual_seed(seed)

    def normal(tensor, mean, deviation):
        tensor.copy_(mean + deviation * torch.randn(tensor.shape, generator=generator, dtype=torch.float64))

    with torch.no_grad():
        for name, tensor in model.state_dict().items():
            if name.endswith("num_batches_tracked"):
                tensor.fill_(3)
            elif name.endswith("running_mean"):
                normal(tensor, 0.0, 0.05)
            elif name.endswith("running_var"):
                tensor.copy_(0.5 + torch.rand(tensor.shape, generator=generator, dtype=torch.float64))
            elif tensor.dim() > 1:
                normal(tensor, 0.0, 0.02 * math.sqrt(64 / width))
            elif name.endswith("weight"):
                normal(tensor, 1.0, 0.1)
            else:
                normal(tensor, 0.0, 0.1)


def zero_by_construction(model):
    """Names of parameters whose gradient is zero in exact arithmetic while training.

    A bias before a normalisation that subtracts the mean, and the key bias, which shifts all scores of a
    softmax alike. In evaluation mode a BatchNorm subtracts a constant instead, and the bias before it counts.
    """
    names = {f"{name}.key.bias" for name, module in model.named_modules() if isinstance(module, Attention)}
    for name, module in model.named_modules():
        if not isinstance(module, nn.Sequential):
            continue
        for i, (layer, following) in enumerate(zip(module, list(module)[1:])):
            subtracts = isinstance(following, nn.InstanceNorm2d) or (
                model.training and isinstance(following, (nn.BatchNorm1d, nn.BatchNorm2d)))
            if subtracts and getattr(layer, "bias", None) is not None:
                names.add(f"{name}.{i}.bias")
    return names
