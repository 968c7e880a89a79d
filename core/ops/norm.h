// Normalisations. Statistics are summed in float64 in a fixed order, the variance from centred values.
#pragma once

#include "core/tensor.h"

namespace opaline {

/// (x - mean) / sqrt(var + eps) * weight + bias over the last dimension D (biased variance).
/// x: .. x D, weight and bias: D.
Tensor layer_norm(const Tensor& x, const Tensor& weight, const Tensor& bias, double eps = 1e-5);

struct BatchNormOptions {
  bool training = true;
  double momentum = 0.1;
  double eps = 1e-5;
  bool relu = false;  ///< the positive part of the result, in the same pass over memory
};

/// Normalises each channel (the last dimension) over all others; 2d and 1d alike.
/// x: .. x C, weight, bias, running_mean, running_var: C.
/// training: batch statistics (biased variance) normalise; the running ones become
/// (1 - momentum) * running + momentum * batch with the unbiased variance n / (n - 1), unchanged where n = 1.
/// Otherwise the running statistics normalise.
/// The running statistics are overwritten in place; an undefined pair means that none are kept (training
/// only).
Tensor batch_norm(const Tensor& x, const Tensor& weight, const Tensor& bias, Tensor running_mean,
                  Tensor running_var, const BatchNormOptions& options = {});

struct InstanceNormOptions {
  double eps = 1e-5;
  bool relu = false;  ///< as of BatchNormOptions
};

/// Normalises each channel of each image over its pixels (biased variance). x: N x H x W x C;
/// weight and bias: C, or both undefined for none.
Tensor instance_norm(const Tensor& x, const Tensor& weight = {}, const Tensor& bias = {},
                     const InstanceNormOptions& options = {});

}  // namespace opaline
