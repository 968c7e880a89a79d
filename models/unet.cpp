#include "models/unet.h"

#include "core/ops/pool.h"
#include "core/ops/resize.h"
#include "core/ops/shape.h"
#include "core/ops/sites.h"
#include "nn/norm.h"

namespace opaline {
namespace {

constexpr int kTransformerBlocks = 8;
constexpr int64_t kHeads = 8;
constexpr int64_t kMlpRatio = 4;
constexpr double kTokenNormEps = 1e-6;

const Conv2d& add_conv_norm_relu(Sequential& sequence, int64_t in, int64_t out,
                                 const DoubleConvConfig& config) {
  const Conv2d& conv = sequence.add<Conv2d>(
      Conv2dConfig{.in = in, .out = out, .kernel = 3, .padding = 1, .dtype = config.dtype});
  if (config.norm == BlockNorm::kBatch) {
    sequence.add<BatchNorm>(
        BatchNormConfig{.channels = out, .scale = kBatchNorm2dScale, .relu = true, .dtype = config.dtype});
  } else {
    sequence.add<InstanceNorm>(InstanceNormConfig{.channels = out, .relu = true, .dtype = config.dtype});
  }
  sequence.skip();  // the rectifier
  return conv;
}

}  // namespace

DoubleConv::DoubleConv(const DoubleConvConfig& config)
    : first_(&add_conv_norm_relu(double_conv_, config.in, config.middle, config)) {
  add_conv_norm_relu(double_conv_, config.middle, config.out, config);
}

Down::Down(const DoubleConvConfig& config) {
  maxpool_conv_.add_function([](const Tensor& x) { return max_pool2d(x, 2); });
  maxpool_conv_.add<DoubleConv>(config);
}

Tensor Up::forward(const Tensor& x, const Tensor& skip) const {
  const ImageSize size = image_size("Up", skip);
  const Tensor upsampled =
      upsample_bilinear(x, {.height = size.h, .width = size.w, .align_corners = true, .sites = skip.sites()});
  const Tensor parts[] = {skip, upsampled};
  return conv_.forward(parts);
}

// Children are made in the order of the reference's state dict: the transformer blocks come last.
TransUnet::TransUnet(const TransUnetConfig& config)
    : config_(config),
      inc_(add_child<DoubleConv>("inc", block(config.in, 1, 1, BlockNorm::kBatch))),
      down1_(add_child<Down>("down1", block(config.width, 2, 2, BlockNorm::kInstance))),
      down2_(add_child<Down>("down2", block(2 * config.width, 4, 4, BlockNorm::kInstance))),
      down3_(add_child<Down>("down3", block(4 * config.width, 8, 8, BlockNorm::kInstance))),
      down4_(add_child<Down>("down4", block(8 * config.width, 8, 8, BlockNorm::kInstance))),
      up1_(add_child<Up>("up1", block(16 * config.width, 8, 4, BlockNorm::kBatch))),
      up2_(add_child<Up>("up2", block(8 * config.width, 4, 2, BlockNorm::kBatch))),
      up3_(add_child<Up>("up3", block(4 * config.width, 2, 1, BlockNorm::kBatch))),
      up4_(add_child<Up>("up4", block(2 * config.width, 1, 1, BlockNorm::kBatch))),
      outc_(add_child<OutConv>(
          "outc", Conv2dConfig{.in = config.width, .out = config.out, .kernel = 1, .dtype = config.dtype})),
      resblock_layers_(add_child<Sequential>("resblock_layers")) {
  const int64_t channels = 8 * config_.width;
  for (int i = 0; i < kTransformerBlocks; ++i) {
    resblock_layers_.add<TransformerBlock>(TransformerBlockConfig{.channels = channels,
                                                                  .heads = kHeads,
                                                                  .mlp_channels = kMlpRatio * channels,
                                                                  .norm_eps = kTokenNormEps,
                                                                  .dtype = config_.dtype});
  }
}

// Inputs in channels, the others in units of the width.
DoubleConvConfig TransUnet::block(int64_t in, int64_t middle, int64_t out, BlockNorm norm) const {
  return {.in = in,
          .middle = middle * config_.width,
          .out = out * config_.width,
          .norm = norm,
          .dtype = config_.dtype};
}

Tensor TransUnet::run(std::span<const Tensor> parts) {
  check_image_input(config_.name, parts, config_.in);
  const Tensor x1 = inc_.forward(parts);
  const Tensor x2 = down1_.forward(x1);
  const Tensor x3 = down2_.forward(x2);
  const Tensor x4 = down3_.forward(x3);
  const Tensor x5 = down4_.forward(x4);

  // Active sites are tokens as they are.
  const ImageSize size = image_size(config_.name, x5);
  const Tensor tokens = x5.sites() ? x5 : reshape(x5, {size.n, size.h * size.w, size.channels});
  const Tensor mixed = resblock_layers_.forward(tokens);
  const Tensor bottom = x5.sites() ? mixed : reshape(mixed, x5.shape());

  Tensor y = up1_.forward(bottom, x4);
  y = up2_.forward(y, x3);
  y = up3_.forward(y, x2);
  y = up4_.forward(y, x1);
  return outc_.forward(y);
}

}  // namespace opaline
