#include "nn/norm.h"

#include "core/autograd.h"

namespace opaline {

Tensor BatchNorm::forward(const Tensor& x) {
  if (training() && x.dim() == 2 && !x.sites() && x.size(0) < 2) {
    fail("BatchNorm", "cannot train on a single sample ({}): use a micro-batch of at least 2, better 8",
         to_string(x.shape()));
  }
  Tensor y = batch_norm(
      x, weight_, bias_, running_mean_, running_var_,
      {.training = training(), .momentum = config_.momentum, .eps = config_.eps, .relu = config_.relu});
  if (training() && !recomputing()) ++*batches_.data<int64_t>();
  return y;
}

}  // namespace opaline
