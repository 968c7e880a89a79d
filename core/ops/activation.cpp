#include "core/ops/activation.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/ops/pointwise.h"

namespace opaline {

Tensor relu(const Tensor& x) {
  return pointwise(
      "relu", x, Saved::kOutput, []<class T>(T v) { return v < T{} ? T{} : v; },  // NaN passes
      []<class T>(T dy, T y) { return y <= T{} ? T{} : dy; });                    // as PyTorch where y is NaN
}

Tensor leaky_relu(const Tensor& x, double slope) {
  return pointwise(
      "leaky_relu", x, Saved::kInput,
      [slope]<class T>(T v) { return v > T{} ? v : v * static_cast<T>(slope); },
      [slope]<class T>(T dy, T v) { return v > T{} ? dy : dy * static_cast<T>(slope); });
}

Tensor gelu(const Tensor& x) {
  return pointwise(
      "gelu", x, Saved::kInput,
      []<class T>(T v) { return v * T(0.5) * (T(1) + std::erf(v * std::numbers::sqrt2_v<T> / T(2))); },
      []<class T>(T dy, T v) {
        const T cdf = T(0.5) * (T(1) + std::erf(v * std::numbers::sqrt2_v<T> / T(2)));
        const T pdf = std::exp(T(-0.5) * v * v) * std::numbers::inv_sqrtpi_v<T> / std::numbers::sqrt2_v<T>;
        return dy * (cdf + v * pdf);  // NaN for an infinite v, as PyTorch's
      });
}

Tensor tanh(const Tensor& x) {
  return pointwise(
      "tanh", x, Saved::kOutput, []<class T>(T v) { return std::tanh(v); },
      []<class T>(T dy, T y) { return dy * (T(1) - y * y); });
}

Tensor sigmoid(const Tensor& x) {
  return pointwise(
      "sigmoid", x, Saved::kOutput,
      []<class T>(T v) {
        const T e = std::exp(-std::abs(v));  // at most 1: no overflow
        return (v < T{} ? e : T(1)) / (T(1) + e);
      },
      []<class T>(T dy, T y) { return dy * y * (T(1) - y); });
}

Tensor softmax(const Tensor& x) {
  if (x.dim() < 1 || x.size(-1) < 1) fail("softmax", "input has shape {}", to_string(x.shape()));
  const int64_t columns = x.size(-1), rows = x.numel() / columns;
  const int64_t block = std::max<int64_t>(1, kPointwiseBlock / 8 / columns);
  Tensor y(x.shape(), x.dtype());
  dispatch_floating("softmax", x.dtype(), [&]<class T>() {
    parallel_blocks(rows, block, [&](int64_t begin, int64_t end) {
      for (int64_t row = begin; row < end; ++row) {
        const T* const from = x.data<T>() + row * columns;
        T* const to = y.data<T>() + row * columns;
        const T largest = *std::max_element(from, from + columns);
        double total = 0.0;
        for (int64_t j = 0; j < columns; ++j) {
          to[j] = std::exp(from[j] - largest);
          total += static_cast<double>(to[j]);
        }
        const T scale = static_cast<T>(1.0 / total);  // total >= 1: the largest term is 1
        for (int64_t j = 0; j < columns; ++j) to[j] *= scale;
      }
    });
  });
  if (!should_record({&x})) return y;
  return record("softmax", y, {x},
                [y = y.detach(), rows, columns, block](const Tensor& dy, std::span<const char>) {
                  Tensor dx(dy.shape(), dy.dtype());
                  dispatch_floating("softmax", dy.dtype(), [&]<class T>() {
                    parallel_blocks(rows, block, [&](int64_t begin, int64_t end) {
                      for (int64_t row = begin; row < end; ++row) {
                        const T* const p = y.data<T>() + row * columns;
                        const T* const g = dy.data<T>() + row * columns;
                        T* const to = dx.data<T>() + row * columns;
                        double dot = 0.0;
                        for (int64_t j = 0; j < columns; ++j)
                          dot += static_cast<double>(p[j]) * static_cast<double>(g[j]);
                        for (int64_t j = 0; j < columns; ++j) to[j] = p[j] * (g[j] - static_cast<T>(dot));
                      }
                    });
                  });
                  return std::vector<Tensor>{dx};
                });
}

}  // namespace opaline
