#include "nn/linear.h"

namespace opaline {

FcStack::FcStack(const FcStackConfig& config) : activation_(config.activation) {
  if (config.widths.size() < 2) {
    fail("FcStack", "needs the widths of input and output, got {}", config.widths.size());
  }
  for (size_t i = 1; i < config.widths.size(); ++i) {
    layers_.push_back(&add_child<Linear>(
        fmt::format("fc{}", i),
        LinearConfig{.in = config.widths[i - 1], .out = config.widths[i], .dtype = config.dtype}));
  }
}

Tensor FcStack::forward(const Tensor& x) const {
  Tensor y = layers_.front()->forward(x);
  for (size_t i = 1; i < layers_.size(); ++i) y = layers_[i]->forward(activation_(y));
  return y;
}

}  // namespace opaline
