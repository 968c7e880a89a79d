#include <cmath>
#include <vector>

#include "core/autograd.h"
#include "core/kernels/transformer.h"
#include "core/ops/norm.h"
#include "core/parallel.h"

namespace opaline {
namespace {

constexpr int64_t kRowsPerUnit = 64;

void check_channels(std::string_view what, const Tensor& tensor, const Tensor& x) {
  if (tensor.shape() != Shape{x.size(-1)} || tensor.dtype() != x.dtype()) {
    fail("layer_norm", "{} is {} {}, expected {} {} (input {})", what, to_string(tensor.dtype()),
         to_string(tensor.shape()), to_string(x.dtype()), x.size(-1), to_string(x.shape()));
  }
}

}  // namespace

Tensor layer_norm(const Tensor& x, const Tensor& weight, const Tensor& bias, double eps) {
  if (x.dim() < 1 || x.size(-1) < 1) fail("layer_norm", "input has shape {}", to_string(x.shape()));
  check_channels("weight", weight, x);
  check_channels("bias", bias, x);
  const int64_t columns = x.size(-1), rows = x.numel() / columns;
  const auto n = static_cast<double>(columns);
  std::vector<double> mean(static_cast<size_t>(rows)), inverse(mean.size());
  Tensor y(x.shape(), x.dtype());
  y.set_sites(x.sites());
  dispatch_floating("layer_norm", x.dtype(), [&]<class T>() {
    const kernels::TransformerKernels<T>& k = kernels::transformer_kernels<T>();
    parallel_blocks(rows, kRowsPerUnit, [&](int64_t begin, int64_t end) {
      for (int64_t row = begin; row < end; ++row) {
        const T* const from = x.data<T>() + row * columns;
        const auto i = static_cast<size_t>(row);
        mean[i] = k.moments(from, columns, 0.0).sum / n;
        // What rounding left in the mean comes out of the centred values.
        const kernels::RowSums centred = k.moments(from, columns, mean[i]);
        const double rest = centred.sum / n, variance = centred.product / n - rest * rest;
        mean[i] += rest;
        inverse[i] = 1.0 / std::sqrt((variance < 0.0 ? 0.0 : variance) + eps);
        k.normalize(from, columns, mean[i], inverse[i], weight.data<T>(), bias.data<T>(),
                    y.data<T>() + row * columns);
      }
    });
  });
  if (!should_record({&x, &weight, &bias})) return y;
  return record(
      "layer_norm", y, {x, weight, bias},
      [kept = x.saved(), weight = weight.detach(), mean = std::move(mean), inverse = std::move(inverse), rows,
       columns, n](const Tensor& dy, std::span<const char> needs) {
        std::vector<Tensor> grads(3);
        const Tensor input = kept.restored();
        if (needs[0]) grads[0] = Tensor(input.shape(), input.dtype());
        dispatch_floating("layer_norm", dy.dtype(), [&]<class T>() {
          const kernels::TransformerKernels<T>& k = kernels::transformer_kernels<T>();
          const int64_t units = (rows + kRowsPerUnit - 1) / kRowsPerUnit;
          const auto width = static_cast<size_t>(2 * columns);
          std::vector<double> partial(static_cast<size_t>(units) * width, 0.0);
          parallel_blocks(rows, kRowsPerUnit, [&](int64_t begin, int64_t end) {
            double* const sums = partial.data() + static_cast<size_t>(begin / kRowsPerUnit) * width;
            for (int64_t row = begin; row < end; ++row) {
              const T* const v = input.data<T>() + row * columns;
              const T* const g = dy.data<T>() + row * columns;
              const double m = mean[static_cast<size_t>(row)], i = inverse[static_cast<size_t>(row)];
              k.normalize_parameter_sums(v, g, columns, m, i, sums, sums + columns);
              if (!needs[0]) continue;
              // dx = inverse * (g - mean(g) - xhat * mean(g * xhat)) with g = dy * weight.
              const kernels::RowSums s = k.normalize_sums(v, g, columns, m, weight.data<T>());
              k.normalize_gradient(v, g, columns, m, i, weight.data<T>(), s.sum / n, s.product * i * i / n,
                                   grads[0].data<T>() + row * columns);
            }
          });
          for (size_t which : {0, 1}) {
            Tensor& grad = grads[which + 1] = Tensor({columns}, dy.dtype());
            for (int64_t j = 0; j < columns; ++j) {
              double total = 0.0;
              for (int64_t unit = 0; unit < units; ++unit) {
                total += partial[static_cast<size_t>(unit) * width + which * static_cast<size_t>(columns) +
                                 static_cast<size_t>(j)];
              }
              grad.data<T>()[j] = static_cast<T>(total);
            }
          }
        });
        return grads;
      },
      [kept = x.saved(), weight = weight.detach(), bias = bias.detach(), eps] {
        return layer_norm(kept.restored(), weight, bias, eps);
      });
}

}  // namespace opaline
