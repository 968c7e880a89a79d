#!/usr/bin/python3
"""Golden values of every operation case from PyTorch in float64: results, all gradients, updated inputs.

  build/release/opaline gradcheck --write-inputs /tmp/inputs.safetensors
  scripts/golden/ops.py /tmp/inputs.safetensors

writes tests/core/ops/golden/<operation>.safetensors. The first command writes the registry's inputs,
cotangents and options (core/check/op_case.h); run both after a case is added or changed. A tensor of up to
256 values is kept as it is; of a larger one every 37th value and the norm.
"""

import argparse
import json
import math
import pathlib
import sys

import numpy as np
import torch
import torch.nn.functional as F

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "scripts" / "golden"))

import safetensors_io  # noqa: E402

# Agreed with core/check/run.cpp.
WHOLE_TENSOR = 256
SAMPLE_STRIDE = 37


def nchw(x):
    return x.permute(0, 3, 1, 2)


def nhwc(x):
    # PyTorch 1.13's instance_norm misreads a gradient that arrives in channels-last order for one image.
    if x.requires_grad:
        x.register_hook(lambda grad: grad.contiguous())
    return x.permute(0, 2, 3, 1)


def conv2d(t, o):
    x = torch.cat([t["x"], t["other"]], -1) if "other" in t else t["x"]
    x, padding = nchw(x), o["padding"]
    if o["reflect"]:
        x, padding = F.pad(x, (padding,) * 4, mode="reflect"), 0
    return nhwc(F.conv2d(x, t["weight"], t.get("bias"), stride=o["stride"], padding=padding))


def conv_transpose2d(t, o):
    return nhwc(F.conv_transpose2d(nchw(t["x"]), t["weight"], t.get("bias"), stride=o["stride"],
                                   padding=o["padding"]))


def matmul(t, o):
    a = t["a"].transpose(-1, -2) if o["transpose_a"] else t["a"]
    b = t["b"].transpose(-1, -2) if o["transpose_b"] else t["b"]
    return a @ b


def attention(t, o):
    """Written out: PyTorch 1.13 has no function of its own for it."""
    def split(x):
        return x.reshape(*x.shape[:2], o["heads"], x.shape[2] // o["heads"]).transpose(1, 2)

    q, k, v = split(t["query"]), split(t["key"]), split(t["value"])
    mixed = torch.softmax(q @ k.transpose(-1, -2) / math.sqrt(q.shape[-1]), -1) @ v
    return mixed.transpose(1, 2).reshape(t["query"].shape)


def normalized(x, weight, bias, dims, eps=1e-5):
    """What PyTorch's norms compute, for the single values that they refuse."""
    y = (x - x.mean(dims, keepdim=True)) / torch.sqrt(x.var(dims, unbiased=False, keepdim=True) + eps)
    return y * weight + bias


def rectified(y, o):
    return F.relu(y) if o["relu"] else y


def batch_norm(t, o):
    x = t["x"]
    mean, var = t.get("running_mean"), t.get("running_var")
    if o["training"] and x.numel() == x.shape[-1]:
        # One value a channel: its variance is not defined, and the running one stays.
        with torch.no_grad():
            mean.mul_(1 - o["momentum"]).add_(o["momentum"] * x.reshape(-1))
        return rectified(normalized(x, t["weight"], t["bias"], 0), o)
    rows = x.reshape(-1, x.shape[-1])
    return rectified(F.batch_norm(rows, mean, var, t["weight"], t["bias"], o["training"], o["momentum"],
                                  1e-5).reshape(x.shape), o)


def instance_norm(t, o):
    x = t["x"]
    if x.shape[1] * x.shape[2] == 1:
        return rectified(normalized(x, t["weight"], t["bias"], (1, 2)), o)
    return rectified(nhwc(F.instance_norm(nchw(x), weight=t.get("weight"), bias=t.get("bias"))), o)


def safe_sqrt(t, _):
    x = t["x"]
    positive = torch.sqrt(torch.where(x > 0, x, torch.ones_like(x)))
    return torch.where(x > 0, positive, torch.where(x.isnan(), x, torch.zeros_like(x)).detach())


def bilinear(t, o):
    return nhwc(F.interpolate(nchw(t["x"]), size=(o["height"], o["width"]), mode="bilinear",
                              align_corners=o["align_corners"]))


def sliced(t, o):
    return t["x"].narrow(o["axis"], o["begin"], o["end"] - o["begin"])


def reduced(function):
    return lambda t, o: (function(t["x"], o["axis"], keepdim=o["keepdim"]) if "axis" in o
                         else function(t["x"]))


def masked(pixel_loss):
    """Mean over images of the mean of pixel_loss over the mask; 0 for an empty mask."""
    def loss(t, _):
        total = 0.0
        for x, target, mask in zip(t["x"], t["target"], t["mask"]):
            inside = mask[..., 0] > 0
            # An empty selection, times 0, still belongs to the graph.
            total = total + (pixel_loss(x[inside], target[inside]).mean() if inside.any()
                             else 0.0 * x[inside].sum())
        return total / len(t["x"])
    return loss


OPERATIONS = {
    "conv2d": conv2d,
    "conv_transpose2d": conv_transpose2d,
    "reflection_pad2d": lambda t, o: nhwc(F.pad(nchw(t["x"]), (o["padding"],) * 4, mode="reflect")),
    "linear": lambda t, _: F.linear(t["x"], t["weight"], t.get("bias")),
    "matmul": matmul,
    "scaled_dot_product_attention": attention,
    "layer_norm": lambda t, o: F.layer_norm(t["x"], t["x"].shape[-1:], t["weight"], t["bias"], o["eps"]),
    "batch_norm": batch_norm,
    "instance_norm": instance_norm,
    "relu": lambda t, _: F.relu(t["x"]),
    "leaky_relu": lambda t, o: F.leaky_relu(t["x"], o["slope"]),
    "gelu": lambda t, _: F.gelu(t["x"]),
    "tanh": lambda t, _: torch.tanh(t["x"]),
    "sigmoid": lambda t, _: torch.sigmoid(t["x"]),
    "softmax": lambda t, _: torch.softmax(t["x"], -1),
    "abs": lambda t, _: torch.abs(t["x"]),
    "square": lambda t, _: torch.square(t["x"]),
    "safe_sqrt": safe_sqrt,
    "clamp": lambda t, o: torch.clamp(t["x"], o["low"], o["high"]),
    "normalize": lambda t, o: F.normalize(t["x"], dim=-1, eps=o["eps"]),
    "add": lambda t, _: t["a"] + t["b"],
    "sub": lambda t, _: t["a"] - t["b"],
    "mul": lambda t, _: t["a"] * t["b"],
    "div": lambda t, _: t["a"] / t["b"],
    "affine": lambda t, o: t["a"] * o["scale"] + o["offset"],
    "max_pool2d": lambda t, o: nhwc(F.max_pool2d(nchw(t["x"]), o["kernel"])),
    "adaptive_avg_pool2d": lambda t, o: nhwc(F.adaptive_avg_pool2d(nchw(t["x"]), (o["height"], o["width"]))),
    "upsample_bilinear": bilinear,
    "upsample_nearest": lambda t, o: nhwc(F.interpolate(nchw(t["x"]), size=(o["height"], o["width"]))),
    "sum": reduced(torch.sum),
    "mean": reduced(torch.mean),
    "concat": lambda t, o: torch.cat(list(t.values()), o["axis"]),
    "reshape": lambda t, o: t["x"].reshape(o["shape"]),
    "permute": lambda t, o: t["x"].permute(o["order"]),
    "slice": sliced,
    "expand": lambda t, o: t["x"].expand(o["shape"]),
    "to_nhwc": lambda t, _: nhwc(t["x"]),
    "to_nchw": lambda t, _: nchw(t["x"]),
    "masked_l1_loss": masked(lambda x, target: (x - target).abs()),
    "masked_mse_loss": masked(lambda x, target: (x - target).square()),
    "cosine_loss": masked(lambda x, target: 1.0 - F.cosine_similarity(x, target, dim=-1)),
    "l1_loss": lambda t, _: F.l1_loss(t["x"], t["target"]),
    "mse_loss": lambda t, _: F.mse_loss(t["x"], t["target"]),
}


def keep(result, key, tensor):
    """Adds a tensor to what is written, or a sample and the norm of a large one."""
    values = tensor.detach().numpy()
    if values.size <= WHOLE_TENSOR:
        result[key] = values
    else:
        flat = values.ravel()
        result[key + ".sample"] = flat[::SAMPLE_STRIDE]
        result[key + ".norm"] = np.float64(np.linalg.norm(flat))


def run_case(name, description, tensors):
    operation, variant = name.split("/", 1)
    inputs = {}
    for key in description["inputs"]:
        inputs[key] = torch.from_numpy(tensors[f"{name}/{key}"].astype(np.float64))
        inputs[key].requires_grad_(key in description["differentiable"])
    y = OPERATIONS[operation](inputs, description["options"])
    cotangent = torch.from_numpy(tensors[f"{name}/cotangent"].astype(np.float64))
    if y.shape != cotangent.shape:
        raise ValueError(f"{name}: PyTorch gives {tuple(y.shape)}, opaline {tuple(cotangent.shape)}")
    y.backward(cotangent)
    result = {}
    keep(result, f"{variant}/y", y)
    for key in description["differentiable"]:
        grad = inputs[key].grad
        keep(result, f"{variant}/grad.{key}", torch.zeros_like(inputs[key]) if grad is None else grad)
    for key in description["updated"]:
        keep(result, f"{variant}/updated.{key}", inputs[key])
    return operation, result


def main():
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("inputs", help="what `opaline gradcheck --write-inputs` wrote")
    parser.add_argument("--out", type=pathlib.Path, default=ROOT / "tests" / "core" / "ops" / "golden")
    arguments = parser.parse_args()
    tensors, metadata = safetensors_io.load_with_metadata(arguments.inputs)
    files = {}
    for name, description in sorted(metadata.items()):
        if name == "xxh64":
            continue
        operation, result = run_case(name, json.loads(description), tensors)
        files.setdefault(operation, {}).update(result)
    arguments.out.mkdir(parents=True, exist_ok=True)
    for path in arguments.out.glob("*.safetensors"):
        path.unlink()
    for operation, result in files.items():
        safetensors_io.save(arguments.out / f"{operation}.safetensors", result)
    print(f"{len(files)} files in {arguments.out}")


if __name__ == "__main__":
    main()
