// Elementwise arithmetic of two tensors, broadcast as in NumPy and PyTorch: shapes are aligned at the last
// dimension, and sizes of one are repeated.
#pragma once

#include "core/tensor.h"

namespace opaline {

Tensor add(const Tensor& a, const Tensor& b);
Tensor sub(const Tensor& a, const Tensor& b);
Tensor mul(const Tensor& a, const Tensor& b);
/// a / b by IEEE rules: a division by zero gives an infinity or NaN, as in PyTorch.
Tensor div(const Tensor& a, const Tensor& b);
/// scale * a + offset with constants.
Tensor affine(const Tensor& a, double scale, double offset = 0.0);

}  // namespace opaline
