#include "core/ops/unary.h"

#include <algorithm>
#include <cmath>

#include "core/ops/pointwise.h"

namespace opaline {

Tensor abs(const Tensor& x) {
  return pointwise(
      "abs", x, Saved::kInput, []<class T>(T v) { return std::abs(v); },
      []<class T>(T dy, T v) { return v > T{}   ? dy
                                      : v < T{} ? -dy
                                                : T{}; });
}

Tensor square(const Tensor& x) {
  return pointwise(
      "square", x, Saved::kInput, []<class T>(T v) { return v * v; },
      []<class T>(T dy, T v) { return T(2) * v * dy; });
}

Tensor safe_sqrt(const Tensor& x) {
  return pointwise(
      "safe_sqrt", x, Saved::kOutput, []<class T>(T v) { return std::sqrt(v < T{} ? T{} : v); },
      []<class T>(T dy, T y) { return y > T{} ? dy / (T(2) * y) : T{}; });
}

Tensor clamp(const Tensor& x, double low, double high) {
  if (!(low <= high)) fail("clamp", "low {} is not below high {}", low, high);
  return pointwise(
      "clamp", x, Saved::kInput,
      [low, high]<class T>(T v) {
        return v < static_cast<T>(low)    ? static_cast<T>(low)
               : v > static_cast<T>(high) ? static_cast<T>(high)
                                          : v;
      },
      [low, high]<class T>(T dy, T v) {
        return v >= static_cast<T>(low) && v <= static_cast<T>(high) ? dy : T{};
      });
}

Tensor normalize(const Tensor& x, double eps) {
  if (x.dim() < 1) fail("normalize", "input has shape {}", to_string(x.shape()));
  const int64_t columns = x.size(-1), rows = columns == 0 ? 0 : x.numel() / columns;
  const int64_t block = std::max<int64_t>(1, kPointwiseBlock / std::max<int64_t>(columns, 1));
  Tensor y(x.shape(), x.dtype());
  dispatch_floating("normalize", x.dtype(), [&]<class T>() {
    parallel_blocks(rows, block, [&](int64_t begin, int64_t end) {
      for (int64_t row = begin; row < end; ++row) {
        const T* const from = x.data<T>() + row * columns;
        T* const to = y.data<T>() + row * columns;
        double squares = 0.0;
        for (int64_t j = 0; j < columns; ++j)
          squares += static_cast<double>(from[j]) * static_cast<double>(from[j]);
        const double length = std::sqrt(squares);
        const double scale = 1.0 / (length < eps ? eps : length);
        for (int64_t j = 0; j < columns; ++j) to[j] = static_cast<T>(static_cast<double>(from[j]) * scale);
      }
    });
  });
  if (!should_record({&x})) return y;
  return record("normalize", y, {x},
                [kept = x.saved(), rows, columns, block, eps](const Tensor& dy, std::span<const char>) {
                  const Tensor input = kept.restored();
                  Tensor dx(dy.shape(), dy.dtype());
                  dispatch_floating("normalize", dy.dtype(), [&]<class T>() {
                    parallel_blocks(rows, block, [&](int64_t begin, int64_t end) {
                      for (int64_t row = begin; row < end; ++row) {
                        const T* const v = input.data<T>() + row * columns;
                        const T* const g = dy.data<T>() + row * columns;
                        T* const to = dx.data<T>() + row * columns;
                        double squares = 0.0, dot = 0.0;
                        for (int64_t j = 0; j < columns; ++j) {
                          squares += static_cast<double>(v[j]) * static_cast<double>(v[j]);
                          dot += static_cast<double>(v[j]) * static_cast<double>(g[j]);
                        }
                        const double length = std::sqrt(squares);
                        // Below eps the divisor is constant.
                        const double scale = 1.0 / (length < eps ? eps : length);
                        const double along = length < eps ? 0.0 : dot * scale * scale;
                        for (int64_t j = 0; j < columns; ++j) {
                          to[j] = static_cast<T>(
                              (static_cast<double>(g[j]) - along * static_cast<double>(v[j])) * scale);
                        }
                      }
                    });
                  });
                  return std::vector<Tensor>{dx};
                });
}

}  // namespace opaline
