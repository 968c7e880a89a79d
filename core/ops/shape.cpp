#include "core/ops/shape.h"

#include <algorithm>
#include <cstring>
#include <utility>
#include <vector>

#include "core/autograd.h"
#include "core/ops/arithmetic.h"
#include "core/ops/reduce.h"
#include "core/ops/sites.h"
#include "core/parallel.h"

namespace opaline {
namespace {

int64_t check_axis(std::string_view operation, const Tensor& x, int64_t axis) {
  const int64_t d = axis < 0 ? axis + x.dim() : axis;
  if (d < 0 || d >= x.dim()) fail(operation, "no dimension {} in shape {}", axis, to_string(x.shape()));
  return d;
}

/// Sizes before, at and after a dimension.
struct Split {
  int64_t outer = 1, size = 1, inner = 1;
};

Split split_at(const Shape& shape, int64_t d) {
  Split s;
  for (int64_t i = 0; i < static_cast<int64_t>(shape.size()); ++i) {
    (i < d ? s.outer : i == d ? s.size : s.inner) *= shape[static_cast<size_t>(i)];
  }
  return s;
}

/// Copies `count` rows of `bytes` between two strided places.
void copy_rows(const std::byte* from, int64_t from_stride, std::byte* to, int64_t to_stride, int64_t count,
               int64_t bytes) {
  if (bytes == 0) return;
  parallel_blocks(count, std::max<int64_t>(1, (1 << 16) / bytes), [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      std::memcpy(to + i * to_stride, from + i * from_stride, static_cast<size_t>(bytes));
    }
  });
}

}  // namespace

Tensor concat(std::span<const Tensor> parts, int64_t axis) {
  if (parts.empty()) fail("concat", "nothing to join");
  const int64_t d = check_axis("concat", parts[0], axis);
  Shape shape = parts[0].shape();
  for (const Tensor& part : parts.subspan(1)) {
    bool fits = part.dim() == parts[0].dim() && part.dtype() == parts[0].dtype();
    for (int64_t i = 0; fits && i < part.dim(); ++i) fits = i == d || part.size(i) == parts[0].size(i);
    if (!fits) {
      fail("concat", "cannot join {} {} and {} {} along dimension {}", to_string(parts[0].dtype()),
           to_string(parts[0].shape()), to_string(part.dtype()), to_string(part.shape()), axis);
    }
    shape[static_cast<size_t>(d)] += part.size(d);
  }
  Tensor y(shape, parts[0].dtype());
  if (d > 0) y.set_sites(common_sites("concat", parts));
  const Split s = split_at(shape, d);
  const int64_t row = s.size * s.inner * size_of(y.dtype());
  int64_t offset = 0;
  for (const Tensor& part : parts) {
    const int64_t bytes = part.size(d) * s.inner * size_of(y.dtype());
    copy_rows(part.bytes(), bytes, y.bytes() + offset, row, s.outer, bytes);
    offset += bytes;
  }
  if (!should_record(parts)) return y;
  std::vector<int64_t> sizes;
  std::vector<Tensor> kept;
  for (const Tensor& part : parts) {
    sizes.push_back(part.size(d));
    kept.push_back(part.saved());
  }
  return record(
      "concat", y, {parts.begin(), parts.end()},
      [sizes, d](const Tensor& dy, std::span<const char> needs) {
        std::vector<Tensor> grads(sizes.size());
        int64_t begin = 0;
        for (size_t i = 0; i < sizes.size(); begin += sizes[i], ++i) {
          if (needs[i]) grads[i] = slice(dy, d, begin, begin + sizes[i]);
        }
        return grads;
      },
      [kept = std::move(kept), d] {
        std::vector<Tensor> values;
        for (const Tensor& part : kept) values.push_back(part.restored());
        return concat(values, d);
      });
}

Tensor concat(std::initializer_list<Tensor> parts, int64_t axis) {
  return concat(std::span(parts.begin(), parts.size()), axis);
}

Tensor reshape(const Tensor& x, Shape shape) {
  int64_t known = 1;
  int64_t* unknown = nullptr;
  bool valid = true;
  for (int64_t& size : shape) {
    if (size == -1 && unknown == nullptr) {
      unknown = &size;
    } else {
      valid = valid && size >= 0;
      known *= size;
    }
  }
  if (unknown != nullptr) *unknown = known > 0 ? x.numel() / known : 0;
  if (!valid || numel(shape) != x.numel()) {
    fail("reshape", "{} elements of shape {} do not fit shape {}", x.numel(), to_string(x.shape()),
         to_string(shape));
  }
  const Tensor y = x.view(std::move(shape));
  if (!should_record({&x})) return y;
  const auto gradient = [shape = x.shape()](const Tensor& dy, std::span<const char>) {
    return std::vector<Tensor>{dy.view(shape)};
  };
  if (!x.recomputes()) return record("reshape", y, {x}, gradient);
  return record("reshape", y, {x}, gradient,
                [kept = x.saved(), shape = y.shape()] { return kept.restored().view(shape); });
}

Tensor permute(const Tensor& x, std::vector<int64_t> order) {
  const auto rank = static_cast<size_t>(x.dim());
  std::vector<int64_t> inverse(rank, -1);
  bool valid = order.size() == rank;
  for (size_t i = 0; valid && i < rank; ++i) {
    valid = order[i] >= 0 && order[i] < x.dim() && inverse[static_cast<size_t>(order[i])] < 0;
    if (valid) inverse[static_cast<size_t>(order[i])] = static_cast<int64_t>(i);
  }
  if (!valid)
    fail("permute", "order {} is no permutation of shape {}", to_string(order), to_string(x.shape()));
  std::vector<int64_t> strides(rank);
  Shape shape(rank);
  {
    std::vector<int64_t> from(rank);
    int64_t stride = 1;
    for (size_t i = rank; i-- > 0; stride *= x.shape()[i]) from[i] = stride;
    for (size_t i = 0; i < rank; ++i) {
      strides[i] = from[static_cast<size_t>(order[i])];
      shape[i] = x.size(order[i]);
    }
  }
  Tensor y(shape, x.dtype());
  if (rank == 0) {
    y.copy_from(x);
  } else if (y.numel() > 0) {
    dispatch_floating("permute", x.dtype(), [&]<class T>() {
      const int64_t columns = shape.back(), rows = y.numel() / columns;
      parallel_blocks(rows, std::max<int64_t>(1, 16384 / columns), [&](int64_t begin, int64_t end) {
        for (int64_t row = begin; row < end; ++row) {
          int64_t rest = row, at = 0;
          for (size_t d = rank - 1; d-- > 0;) {
            at += rest % shape[d] * strides[d];
            rest /= shape[d];
          }
          const T* const from = x.data<T>() + at;
          T* const to = y.data<T>() + row * columns;
          for (int64_t j = 0; j < columns; ++j) to[j] = from[j * strides.back()];
        }
      });
    });
  }
  if (!should_record({&x})) return y;
  return record(
      "permute", y, {x},
      [inverse](const Tensor& dy, std::span<const char>) {
        return std::vector<Tensor>{permute(dy, inverse)};
      },
      [kept = x.saved(), order] { return permute(kept.restored(), order); });
}

Tensor slice(const Tensor& x, int64_t axis, int64_t begin, int64_t end) {
  const int64_t d = check_axis("slice", x, axis);
  if (begin < 0 || end < begin || end > x.size(d)) {
    fail("slice", "[{}, {}) of dimension {} in shape {}", begin, end, axis, to_string(x.shape()));
  }
  Shape shape = x.shape();
  shape[static_cast<size_t>(d)] = end - begin;
  const Split s = split_at(x.shape(), d);
  const int64_t unit = s.inner * size_of(x.dtype());
  Tensor y(shape, x.dtype());
  copy_rows(x.bytes() + begin * unit, s.size * unit, y.bytes(), (end - begin) * unit, s.outer,
            (end - begin) * unit);
  if (!should_record({&x})) return y;
  return record(
      "slice", y, {x},
      [full = x.shape(), s, unit, begin, end](const Tensor& dy, std::span<const char>) {
        Tensor dx = Tensor::zeros(full, dy.dtype());
        copy_rows(dy.bytes(), (end - begin) * unit, dx.bytes() + begin * unit, s.size * unit, s.outer,
                  (end - begin) * unit);
        return std::vector<Tensor>{dx};
      },
      [kept = x.saved(), d, begin, end] { return slice(kept.restored(), d, begin, end); });
}

Tensor expand(const Tensor& x, Shape shape) {
  bool fits = x.dim() <= static_cast<int64_t>(shape.size());
  for (int64_t i = 1; fits && i <= x.dim(); ++i) {
    fits = x.size(-i) == 1 || x.size(-i) == shape[shape.size() - static_cast<size_t>(i)];
  }
  if (!fits) fail("expand", "shape {} does not expand to {}", to_string(x.shape()), to_string(shape));
  // Adding zeros repeats the values and sums their gradients back.
  return add(x, Tensor::zeros(std::move(shape), x.dtype()));
}

Tensor to_nhwc(const Tensor& x) {
  return permute(x, {0, 2, 3, 1});
}

Tensor to_nchw(const Tensor& x) {
  return permute(x, {0, 3, 1, 2});
}

}  // namespace opaline
