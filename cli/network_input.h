// Tensors of networks in files: images are N x C x H x W there and channels last inside, vectors are the same
// in both.
#pragma once

#include <string>

#include "core/safetensors.h"
#include "core/tensor.h"

namespace opaline::cli {

/// As files have it.
Tensor outward(const Tensor& x);

/// Tensor "x" of a file, as a network takes it. Throws Error, naming the file, where there is none or it is
/// not floating.
Tensor read_input(const TensorMap& tensors, DType dtype, const std::string& file);

/// Tensor "cotangent", the gradient of a network's result y: of its shape and type, or an Error as above.
Tensor read_cotangent(const TensorMap& tensors, const Tensor& y, const std::string& file);

}  // namespace opaline::cli
