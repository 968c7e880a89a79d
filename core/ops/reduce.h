// Sums over all elements or one dimension, accumulated in float64 in a fixed tree.
#pragma once

#include "core/tensor.h"

namespace opaline {

/// Sum of all elements; a scalar.
Tensor sum(const Tensor& x);
/// Mean of all elements; a scalar. No elements give NaN, as in PyTorch.
Tensor mean(const Tensor& x);
/// Sum over dimension `axis`, which disappears unless keepdim.
Tensor sum(const Tensor& x, int64_t axis, bool keepdim = false);
Tensor mean(const Tensor& x, int64_t axis, bool keepdim = false);

}  // namespace opaline
