// Normalisation layers (formulas: core/ops/norm.h).
#pragma once

#include "core/ops/norm.h"
#include "nn/module.h"

namespace opaline {

struct BatchNormConfig {
  int64_t channels = 0;
  double eps = 1e-5;
  double momentum = 0.1;
  InitialValue scale = {.mean = 1.0, .deviation = 0.0};  ///< start of the weight
  bool relu = false;                                     ///< a rectifier in the same pass
  DType dtype = DType::kFloat32;
};

/// The recipe's start of the weight of a BatchNorm over images.
inline constexpr InitialValue kBatchNorm2dScale{.mean = 1.0, .deviation = 0.02};

/// PyTorch's BatchNorm1d and BatchNorm2d in one: x is N x C or N x H x W x C. Parameters weight and bias,
/// buffers running_mean, running_var and num_batches_tracked. In training mode each forward pass updates the
/// buffers; vectors (N x C) of a single sample are then an error, because every output would be the bias.
class BatchNorm : public Module {
 public:
  explicit BatchNorm(const BatchNormConfig& config) : config_(config) {}
  Tensor forward(const Tensor& x);

 private:
  BatchNormConfig config_;
  Tensor weight_ = add_parameter("weight", {config_.channels}, config_.dtype, config_.scale);
  Tensor bias_ = add_parameter("bias", {config_.channels}, config_.dtype, {});
  Tensor running_mean_ = add_buffer("running_mean", Tensor::zeros({config_.channels}, config_.dtype));
  Tensor running_var_ = add_buffer("running_var", Tensor::full({config_.channels}, 1.0, config_.dtype));
  Tensor batches_ = add_buffer("num_batches_tracked", Tensor::zeros({}, DType::kInt64));
};

struct InstanceNormConfig {
  int64_t channels = 0;
  bool affine = false;  ///< have weight and bias
  double eps = 1e-5;
  bool relu = false;  ///< a rectifier in the same pass
  DType dtype = DType::kFloat32;
};

/// PyTorch's InstanceNorm2d without running statistics; x: N x H x W x C.
class InstanceNorm : public Module {
 public:
  explicit InstanceNorm(const InstanceNormConfig& config) : config_(config) {}
  Tensor forward(const Tensor& x) const {
    return instance_norm(x, weight_, bias_, {.eps = config_.eps, .relu = config_.relu});
  }

 private:
  InstanceNormConfig config_;
  Tensor weight_ =
      config_.affine ? add_parameter("weight", {config_.channels}, config_.dtype, {.mean = 1.0}) : Tensor();
  Tensor bias_ = config_.affine ? add_parameter("bias", {config_.channels}, config_.dtype, {}) : Tensor();
};

struct LayerNormConfig {
  int64_t channels = 0;
  double eps = 1e-5;
  DType dtype = DType::kFloat32;
};

/// Over the last dimension.
class LayerNorm : public Module {
 public:
  explicit LayerNorm(const LayerNormConfig& config) : config_(config) {}
  Tensor forward(const Tensor& x) const { return layer_norm(x, weight_, bias_, config_.eps); }

 private:
  LayerNormConfig config_;
  Tensor weight_ = add_parameter("weight", {config_.channels}, config_.dtype, {.mean = 1.0});
  Tensor bias_ = add_parameter("bias", {config_.channels}, config_.dtype, {});
};

}  // namespace opaline
