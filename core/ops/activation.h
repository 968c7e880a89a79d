// Pointwise non-linearities and softmax. NaN passes through all of them, as in PyTorch.
#pragma once

#include "core/tensor.h"

namespace opaline {

/// max(x, 0); derivative 0 at 0.
Tensor relu(const Tensor& x);
/// x where x > 0, slope * x elsewhere; derivative `slope` at 0.
Tensor leaky_relu(const Tensor& x, double slope = 0.01);
/// x * Phi(x), Phi the normal distribution function by erf (Hendrycks and Gimpel 2016; not the tanh form).
Tensor gelu(const Tensor& x);
Tensor tanh(const Tensor& x);
/// 1 / (1 + exp(-x)), without overflow.
Tensor sigmoid(const Tensor& x);
/// exp(x - max) / sum exp(x - max) over the last dimension.
Tensor softmax(const Tensor& x);

}  // namespace opaline
