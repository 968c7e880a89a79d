#include <algorithm>
#include <cmath>
#include <vector>

#include "core/autograd.h"
#include "core/ops/norm.h"
#include "core/parallel.h"

namespace opaline {
namespace {

void check_channels(std::string_view operation, std::string_view what, const Tensor& tensor,
                    const Tensor& x) {
  if (tensor.shape() != Shape{x.size(-1)} || tensor.dtype() != x.dtype()) {
    fail(operation, "{} is {} {}, expected {} {} (input {})", what, to_string(tensor.dtype()),
         to_string(tensor.shape()), to_string(x.dtype()), x.size(-1), to_string(x.shape()));
  }
}

/// sums[k][j] = sum over rows of f(row, j)[k], in double: blocks of rows, joined in order. One group at a
/// time; `f` adds its terms for a row to `k` arrays of `columns`.
template <class F>
std::vector<double> row_sums(int64_t rows, int64_t columns, int64_t terms, const F& add_row) {
  constexpr int64_t kBlock = 512;
  const auto width = static_cast<size_t>(terms * columns);
  const int64_t blocks = (rows + kBlock - 1) / kBlock;
  std::vector<double> partial(static_cast<size_t>(blocks) * width, 0.0);
  parallel_for(blocks, [&](int64_t b) {
    double* const to = partial.data() + static_cast<size_t>(b) * width;
    for (int64_t row = b * kBlock; row < std::min(rows, (b + 1) * kBlock); ++row) add_row(row, to);
  });
  std::vector<double> total(width, 0.0);
  for (int64_t b = 0; b < blocks; ++b) {
    for (size_t j = 0; j < width; ++j) total[j] += partial[static_cast<size_t>(b) * width + j];
  }
  return total;
}

template <class T>
Tensor to_tensor(const double* values, int64_t count) {
  Tensor result({count}, dtype_of<T>());
  std::transform(values, values + count, result.data<T>(), [](double v) { return static_cast<T>(v); });
  return result;
}

}  // namespace

Tensor layer_norm(const Tensor& x, const Tensor& weight, const Tensor& bias, double eps) {
  if (x.dim() < 1 || x.size(-1) < 1) fail("layer_norm", "input has shape {}", to_string(x.shape()));
  check_channels("layer_norm", "weight", weight, x);
  check_channels("layer_norm", "bias", bias, x);
  const int64_t columns = x.size(-1), rows = x.numel() / columns;
  std::vector<double> mean(static_cast<size_t>(rows)), inverse(mean.size());
  Tensor y(x.shape(), x.dtype());
  dispatch_floating("layer_norm", x.dtype(), [&]<class T>() {
    const T* const w = weight.data<T>();
    const T* const b = bias.data<T>();
    parallel_blocks(rows, 64, [&](int64_t begin, int64_t end) {
      for (int64_t row = begin; row < end; ++row) {
        const T* const from = x.data<T>() + row * columns;
        T* const to = y.data<T>() + row * columns;
        double total = 0.0, squares = 0.0;
        for (int64_t j = 0; j < columns; ++j) total += static_cast<double>(from[j]);
        const double m = total / static_cast<double>(columns);
        for (int64_t j = 0; j < columns; ++j) {
          const double d = static_cast<double>(from[j]) - m;
          squares += d * d;
        }
        const double i = 1.0 / std::sqrt(squares / static_cast<double>(columns) + eps);
        for (int64_t j = 0; j < columns; ++j) {
          to[j] = static_cast<T>((static_cast<double>(from[j]) - m) * i * static_cast<double>(w[j]) +
                                 static_cast<double>(b[j]));
        }
        mean[static_cast<size_t>(row)] = m;
        inverse[static_cast<size_t>(row)] = i;
      }
    });
  });
  if (!should_record({&x, &weight, &bias})) return y;
  return record(
      "layer_norm", y, {x, weight, bias},
      [kept = x.saved(), weight = weight.detach(), mean = std::move(mean), inverse = std::move(inverse), rows,
       columns](const Tensor& dy, std::span<const char> needs) {
        std::vector<Tensor> grads(3);
        const Tensor input = kept.restored();
        if (needs[0]) grads[0] = Tensor(input.shape(), input.dtype());
        dispatch_floating("layer_norm", dy.dtype(), [&]<class T>() {
          const auto n = static_cast<double>(columns);
          if (needs[0]) {
            parallel_blocks(rows, 64, [&](int64_t begin, int64_t end) {
              for (int64_t row = begin; row < end; ++row) {
                const T* const v = input.data<T>() + row * columns;
                const T* const g = dy.data<T>() + row * columns;
                T* const to = grads[0].data<T>() + row * columns;
                const double m = mean[static_cast<size_t>(row)], i = inverse[static_cast<size_t>(row)];
                double sum_g = 0.0, sum_gx = 0.0;
                for (int64_t j = 0; j < columns; ++j) {
                  const double gw = static_cast<double>(g[j]) * static_cast<double>(weight.data<T>()[j]);
                  sum_g += gw;
                  sum_gx += gw * (static_cast<double>(v[j]) - m) * i;
                }
                for (int64_t j = 0; j < columns; ++j) {
                  const double gw = static_cast<double>(g[j]) * static_cast<double>(weight.data<T>()[j]);
                  const double xhat = (static_cast<double>(v[j]) - m) * i;
                  to[j] = static_cast<T>(i * (gw - sum_g / n - xhat * sum_gx / n));
                }
              }
            });
          }
          if (needs[1] || needs[2]) {
            const auto sums = row_sums(rows, columns, 2, [&](int64_t row, double* to) {
              const T* const v = input.data<T>() + row * columns;
              const T* const g = dy.data<T>() + row * columns;
              const double m = mean[static_cast<size_t>(row)], i = inverse[static_cast<size_t>(row)];
              for (int64_t j = 0; j < columns; ++j) {
                to[j] += static_cast<double>(g[j]);
                to[columns + j] += static_cast<double>(g[j]) * (static_cast<double>(v[j]) - m) * i;
              }
            });
            grads[1] = to_tensor<T>(sums.data() + columns, columns);
            grads[2] = to_tensor<T>(sums.data(), columns);
          }
        });
        return grads;
      },
      [kept = x.saved(), weight = weight.detach(), bias = bias.detach(), eps] {
        return layer_norm(kept.restored(), weight, bias, eps);
      });
}

}  // namespace opaline
