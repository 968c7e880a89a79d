#include "cli/network_input.h"

#include "core/error.h"
#include "core/ops/shape.h"

namespace opaline::cli {
namespace {

Tensor read_tensor(const TensorMap& tensors, const std::string& name, DType dtype, const std::string& file) {
  const auto found = tensors.find(name);
  if (found == tensors.end()) fail(file, "has no tensor '{}'", name);
  if (!found->second.is_floating()) fail(file, "tensor '{}' is not floating", name);
  const Tensor x = found->second.to(dtype);
  return x.dim() == 4 ? to_nhwc(x) : x;
}

}  // namespace

Tensor outward(const Tensor& x) {
  return x.dim() == 4 ? to_nchw(x) : x;
}

Tensor read_input(const TensorMap& tensors, DType dtype, const std::string& file) {
  return read_tensor(tensors, "x", dtype, file);
}

Tensor read_cotangent(const TensorMap& tensors, const Tensor& y, const std::string& file) {
  const Tensor cotangent = read_tensor(tensors, "cotangent", y.dtype(), file);
  if (cotangent.shape() != y.shape()) {
    fail(file, "tensor 'cotangent' is {}, the output {}", to_string(outward(cotangent).shape()),
         to_string(outward(y.detach()).shape()));
  }
  return cotangent;
}

}  // namespace opaline::cli
