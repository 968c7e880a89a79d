#include "models/sss.h"

#include "core/ops/activation.h"
#include "nn/residual.h"

namespace opaline {
namespace {

constexpr int kResidualBlocks = 15;

}  // namespace

SssNetwork::SssNetwork(const SssConfig& config)
    : config_(config), stem_(feature_encoder_.model, config.in, config.width, config.dtype) {
  const int64_t w = config_.width;
  Sequential& features = feature_encoder_.model;
  add_halving_conv(features, w, 2 * w, config_.dtype);
  add_halving_conv(features, 2 * w, 4 * w, config_.dtype);
  for (int i = 0; i < kResidualBlocks; ++i) {
    features.add<ResidualBlock>(ResidualBlockConfig{.channels = 4 * w, .dtype = config_.dtype});
  }

  Sequential& scatter = scatter_encoder_.model;
  add_halving_conv(scatter, 4 * w, 2 * w, config_.dtype);
  add_halving_conv(scatter, 2 * w, w, config_.dtype);
  add_vector_head(scatter,
                  {.in = w, .grid = config_.image_size / 16, .out = config_.out, .dtype = config_.dtype});
  scatter.add_function([](const Tensor& x) { return tanh(x); });
}

Tensor SssNetwork::run(std::span<const Tensor> parts) {
  check_image_input("sss", parts, config_.in);
  return scatter_encoder_.model.forward(stem_.forward(parts));
}

}  // namespace opaline
