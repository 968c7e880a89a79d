#include "models/illumination.h"

#include <algorithm>
#include <cstdint>

#include "core/ops/activation.h"
#include "core/ops/shape.h"

namespace opaline {
namespace {

constexpr int kMaxDoublings = 8;  // to a map of 256 x 256

int ceil_log2(int64_t value) {
  int result = 0;
  while ((int64_t{1} << result) < value) ++result;
  return result;
}

}  // namespace

IlluminationEncoder::IlluminationEncoder(const IlluminationEncoderConfig& config)
    : config_(config), stem_(model_, config.in, config.width, config.dtype) {
  const int64_t w = config_.width;
  add_halving_conv(model_, w, 2 * w, config_.dtype);
  add_halving_conv(model_, 2 * w, 4 * w, config_.dtype);
  add_halving_conv(model_, 4 * w, 8 * w, config_.dtype);
  add_vector_head(model_,
                  {.in = 8 * w, .grid = config_.image_size / 8, .out = config_.out, .dtype = config_.dtype});
}

Tensor IlluminationEncoder::run(std::span<const Tensor> parts) {
  if (parts.front().sites()) fail("illumination", "needs whole images: its cue lies around the object");
  check_image_input("illumination", parts, config_.in);
  return stem_.forward(parts);
}

IlluminationDecoder::IlluminationDecoder(const IlluminationDecoderConfig& config) : config_(config) {
  // The channels of the full list are 16w, 8w, .. w/4, 1; smaller images take its last ones.
  const int doublings = std::min(kMaxDoublings, ceil_log2(config_.image_size));
  int64_t in = config_.in;
  for (int left = doublings - 1; left >= 0; --left) {
    const int64_t out = left == 0 ? 1 : (config_.width << (left - 1)) / 4;
    model_.add<ConvTranspose2d>(
        ConvTranspose2dConfig{.in = in, .out = out, .bias = false, .dtype = config_.dtype});
    model_.add<BatchNorm>(BatchNormConfig{
        .channels = out, .scale = kBatchNorm2dScale, .relu = left > 0, .dtype = config_.dtype});
    if (left > 0) {
      model_.skip();  // the rectifier
    } else {
      model_.add_function([](const Tensor& x) { return tanh(x); });
    }
    in = out;
  }
}

Tensor IlluminationDecoder::run(std::span<const Tensor> parts) {
  const Tensor& x = parts.front();
  if (parts.size() != 1) fail("illumination_decoder", "takes one input, not {} parts", parts.size());
  if (x.dim() != 2 || x.size(1) != config_.in) {
    fail("illumination_decoder", "input is {}, expected N x {}", to_string(x.shape()), config_.in);
  }
  return model_.forward(reshape(x, {x.size(0), 1, 1, config_.in}));
}

}  // namespace opaline
