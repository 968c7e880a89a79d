// Convolution layers over N x H x W x C; weights in PyTorch's layout, started from normal(0, 0.02), bias from
// 0.
#pragma once

#include "core/ops/conv.h"
#include "nn/module.h"

namespace opaline {

/// The recipe's start of the weights of convolutions and linear layers.
inline constexpr InitialValue kWeightInit{.mean = 0.0, .deviation = 0.02};

struct Conv2dConfig {
  int64_t in = 0;
  int64_t out = 0;
  int64_t kernel = 3;
  int64_t stride = 1;
  int64_t padding = 0;
  Padding padding_mode = Padding::kZeros;
  bool bias = true;
  DType dtype = DType::kFloat32;
};

/// weight: out x in x kernel x kernel; bias: out.
class Conv2d : public Module {
 public:
  explicit Conv2d(const Conv2dConfig& config) : config_(config) {}
  Tensor forward(const Tensor& x) const { return forward(std::span(&x, 1)); }
  /// Of images joined along their channels.
  Tensor forward(std::span<const Tensor> parts) const {
    return conv2d(
        parts, weight_, bias_,
        {.stride = config_.stride, .padding = config_.padding, .padding_mode = config_.padding_mode});
  }

 private:
  Conv2dConfig config_;
  Tensor weight_ = add_parameter("weight", {config_.out, config_.in, config_.kernel, config_.kernel},
                                 config_.dtype, kWeightInit);
  Tensor bias_ = config_.bias ? add_parameter("bias", {config_.out}, config_.dtype, {}) : Tensor();
};

struct ConvTranspose2dConfig {
  int64_t in = 0;
  int64_t out = 0;
  int64_t kernel = 4;
  int64_t stride = 2;
  int64_t padding = 1;
  bool bias = true;
  DType dtype = DType::kFloat32;
};

/// weight: in x out x kernel x kernel; bias: out.
class ConvTranspose2d : public Module {
 public:
  explicit ConvTranspose2d(const ConvTranspose2dConfig& config) : config_(config) {}
  Tensor forward(const Tensor& x) const {
    return conv_transpose2d(x, weight_, bias_, {.stride = config_.stride, .padding = config_.padding});
  }

 private:
  ConvTranspose2dConfig config_;
  Tensor weight_ = add_parameter("weight", {config_.in, config_.out, config_.kernel, config_.kernel},
                                 config_.dtype, kWeightInit);
  Tensor bias_ = config_.bias ? add_parameter("bias", {config_.out}, config_.dtype, {}) : Tensor();
};

}  // namespace opaline
