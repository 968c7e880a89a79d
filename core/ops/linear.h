// Matrix products.
#pragma once

#include "core/tensor.h"

namespace opaline {

/// y = x weight^T + bias over the last dimension. x: .. x in, weight: out x in, bias: out or undefined.
/// Result: .. x out.
Tensor linear(const Tensor& x, const Tensor& weight, const Tensor& bias = {});

struct MatmulOptions {
  bool transpose_a = false;
  bool transpose_b = false;
};

/// Batched product of the last two dimensions; the leading dimensions must be equal.
/// a: .. x M x K (K x M if transposed), b: .. x K x N (N x K if transposed). Result: .. x M x N.
Tensor matmul(const Tensor& a, const Tensor& b, const MatmulOptions& options = {});

}  // namespace opaline
