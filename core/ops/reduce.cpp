#include "core/ops/reduce.h"

#include <algorithm>
#include <vector>

#include "core/autograd.h"
#include "core/ops/shape.h"
#include "core/parallel.h"

namespace opaline {
namespace {

constexpr int64_t kBlock = 4096;

template <class T>
double total(const Tensor& x) {
  const int64_t blocks = (x.numel() + kBlock - 1) / kBlock;
  std::vector<double> partial(static_cast<size_t>(blocks));
  const T* const from = x.data<T>();
  parallel_blocks(x.numel(), kBlock, [&](int64_t begin, int64_t end) {
    double s = 0.0;
    for (int64_t i = begin; i < end; ++i) s += static_cast<double>(from[i]);
    partial[static_cast<size_t>(begin / kBlock)] = s;
  });
  double s = 0.0;
  for (const double p : partial) s += p;
  return s;
}

/// Scaled sum of all elements: what sum and mean share.
Tensor reduce_all(std::string_view operation, const Tensor& x, double scale) {
  Tensor y = dispatch_floating(operation, x.dtype(),
                               [&]<class T>() { return Tensor::scalar(total<T>(x) * scale, x.dtype()); });
  if (!should_record({&x})) return y;
  return record(operation, y, {x}, [shape = x.shape(), scale](const Tensor& dy, std::span<const char>) {
    return std::vector<Tensor>{Tensor::full(shape, dy.item() * scale, dy.dtype())};
  });
}

/// Scaled sum over one dimension.
Tensor reduce_axis(std::string_view operation, const Tensor& x, int64_t axis, bool keepdim, bool average) {
  const int64_t d = axis < 0 ? axis + x.dim() : axis;
  if (d < 0 || d >= x.dim()) fail(operation, "no dimension {} in shape {}", axis, to_string(x.shape()));
  const int64_t size = x.size(d);
  int64_t inner = 1, outer = 1;
  for (int64_t i = d + 1; i < x.dim(); ++i) inner *= x.size(i);
  for (int64_t i = 0; i < d; ++i) outer *= x.size(i);
  Shape kept = x.shape();
  kept[static_cast<size_t>(d)] = 1;
  Shape shape = kept;
  if (!keepdim) shape.erase(shape.begin() + d);
  const double scale = average ? 1.0 / static_cast<double>(size) : 1.0;

  Tensor y(shape, x.dtype());
  dispatch_floating(operation, x.dtype(), [&]<class T>() {
    const T* const from = x.data<T>();
    T* const to = y.data<T>();
    constexpr int64_t kColumns = 256;
    const int64_t column_blocks = (inner + kColumns - 1) / kColumns;
    parallel_for(outer * column_blocks, [&](int64_t unit) {
      const int64_t o = unit / column_blocks, first = unit % column_blocks * kColumns;
      const int64_t count = std::min(kColumns, inner - first);
      std::vector<double> sums(static_cast<size_t>(count), 0.0);
      for (int64_t k = 0; k < size; ++k) {
        const T* const row = from + (o * size + k) * inner + first;
        for (int64_t j = 0; j < count; ++j) sums[static_cast<size_t>(j)] += static_cast<double>(row[j]);
      }
      for (int64_t j = 0; j < count; ++j) {
        to[o * inner + first + j] = static_cast<T>(sums[static_cast<size_t>(j)] * scale);
      }
    });
  });
  if (!should_record({&x})) return y;
  return record(operation, y, {x},
                [kept, full = x.shape(), outer, inner, size, scale](const Tensor& dy, std::span<const char>) {
                  Tensor dx(full, dy.dtype());
                  dispatch_floating("sum", dy.dtype(), [&]<class T>() {
                    const T* const from = dy.data<T>();
                    T* const to = dx.data<T>();
                    parallel_for(outer, [&](int64_t o) {
                      for (int64_t k = 0; k < size; ++k) {
                        for (int64_t j = 0; j < inner; ++j) {
                          to[(o * size + k) * inner + j] = from[o * inner + j] * static_cast<T>(scale);
                        }
                      }
                    });
                  });
                  return std::vector<Tensor>{dx};
                });
}

}  // namespace

Tensor sum(const Tensor& x) {
  return reduce_all("sum", x, 1.0);
}

Tensor mean(const Tensor& x) {
  return reduce_all("mean", x, 1.0 / static_cast<double>(x.numel()));
}

Tensor sum(const Tensor& x, int64_t axis, bool keepdim) {
  return reduce_axis("sum", x, axis, keepdim, false);
}

Tensor mean(const Tensor& x, int64_t axis, bool keepdim) {
  return reduce_axis("mean", x, axis, keepdim, true);
}

}  // namespace opaline
