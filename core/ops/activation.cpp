#include "core/ops/activation.h"

#include <algorithm>
#include <cmath>

#include "core/kernels/transformer.h"
#include "core/ops/pointwise.h"

namespace opaline {

Tensor relu(const Tensor& x) {
  return pointwise(
      "relu", x, Saved::kInput, []<class T>(T v) { return v < T{} ? T{} : v; },  // NaN passes
      []<class T>(T dy, T v) { return v <= T{} ? T{} : dy; });                   // as PyTorch where v is NaN
}

Tensor leaky_relu(const Tensor& x, double slope) {
  return pointwise(
      "leaky_relu", x, Saved::kInput,
      [slope]<class T>(T v) { return v > T{} ? v : v * static_cast<T>(slope); },
      [slope]<class T>(T dy, T v) { return v > T{} ? dy : dy * static_cast<T>(slope); });
}

Tensor gelu(const Tensor& x) {
  Tensor y(x.shape(), x.dtype());
  y.set_sites(x.sites());
  dispatch_floating("gelu", x.dtype(), [&]<class T>() {
    parallel_blocks(x.numel(), kPointwiseBlock, [&](int64_t begin, int64_t end) {
      kernels::transformer_kernels<T>().gelu(x.data<T>() + begin, end - begin, y.data<T>() + begin);
    });
  });
  if (!should_record({&x})) return y;
  return record(
      "gelu", y, {x},
      [kept = x.saved()](const Tensor& dy, std::span<const char>) {
        const Tensor values = kept.restored();
        Tensor dx(dy.shape(), dy.dtype());
        dispatch_floating("gelu", dy.dtype(), [&]<class T>() {
          parallel_blocks(dy.numel(), kPointwiseBlock, [&](int64_t begin, int64_t end) {
            kernels::transformer_kernels<T>().gelu_gradient(values.data<T>() + begin, dy.data<T>() + begin,
                                                            end - begin, dx.data<T>() + begin);
          });
        });
        return std::vector<Tensor>{dx};
      },
      [kept = x.saved()] { return gelu(kept.restored()); });
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
        kernels::transformer_kernels<T>().softmax(x.data<T>() + row * columns, columns, T(1),
                                                  y.data<T>() + row * columns);
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
                        const int64_t at = row * columns;
                        kernels::transformer_kernels<T>().softmax_gradient(
                            y.data<T>() + at, dy.data<T>() + at, columns, T(1), dx.data<T>() + at);
                      }
                    });
                  });
                  return std::vector<Tensor>{dx};
                });
}

}  // namespace opaline
