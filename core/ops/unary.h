// Other functions of one tensor.
#pragma once

#include "core/tensor.h"

namespace opaline {

/// |x|; derivative sign(x), 0 at 0.
Tensor abs(const Tensor& x);
Tensor square(const Tensor& x);
/// sqrt(max(x, 0)); derivative 0 where x <= 0, so that a zero costs no NaN. NaN passes.
Tensor safe_sqrt(const Tensor& x);
/// min(max(x, low), high); derivative 1 inside and at the ends, 0 outside, as in PyTorch.
Tensor clamp(const Tensor& x, double low, double high);
/// x / max(|x|, eps) over the last dimension, as PyTorch's normalize; a zero vector stays zero.
Tensor normalize(const Tensor& x, double eps = 1e-12);

}  // namespace opaline
