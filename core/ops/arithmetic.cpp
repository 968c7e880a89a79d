#include "core/ops/arithmetic.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "core/ops/pointwise.h"
#include "core/ops/reduce.h"
#include "core/ops/sites.h"

namespace opaline {
namespace {

/// The shape that two broadcast to.
Shape broadcast_shape(std::string_view operation, const Tensor& a, const Tensor& b) {
  if (a.dtype() != b.dtype()) {
    fail(operation, "operands are {} and {}", to_string(a.dtype()), to_string(b.dtype()));
  }
  const auto rank = static_cast<size_t>(std::max(a.dim(), b.dim()));
  Shape shape(rank);
  for (size_t i = 0; i < rank; ++i) {
    const auto size = [&](const Tensor& t) {
      const size_t missing = rank - t.shape().size();
      return i < missing ? int64_t{1} : t.shape()[i - missing];
    };
    const int64_t p = size(a), q = size(b);
    if (p != q && p != 1 && q != 1) {
      fail(operation, "shapes {} and {} do not broadcast", to_string(a.shape()), to_string(b.shape()));
    }
    shape[i] = p == 1 ? q : p;
  }
  return shape;
}

/// Strides that walk `shape` through a tensor of shape `from`: 0 along repeated dimensions.
std::vector<int64_t> broadcast_strides(const Shape& from, const Shape& shape) {
  std::vector<int64_t> strides(shape.size(), 0);
  int64_t stride = 1;
  for (size_t i = from.size(); i-- > 0;) {
    strides[i + shape.size() - from.size()] = from[i] == 1 ? 0 : stride;
    stride *= from[i];
  }
  return strides;
}

/// c = f(a, b), broadcast. Rows of the last dimension are the unit of work.
template <class T, class F>
void broadcast_map(const Tensor& a, const Tensor& b, Tensor& c, const F& f) {
  const Shape& shape = c.shape();
  if (a.shape() == shape && b.shape() == shape) return map<T>(a, b, c, f);
  const auto sa = broadcast_strides(a.shape(), shape), sb = broadcast_strides(b.shape(), shape);
  const int64_t columns = shape.back(), rows = columns == 0 ? 0 : c.numel() / columns;
  parallel_blocks(rows, std::max<int64_t>(1, kPointwiseBlock / std::max<int64_t>(columns, 1)),
                  [&](int64_t begin, int64_t end) {
                    for (int64_t row = begin; row < end; ++row) {
                      int64_t rest = row, ia = 0, ib = 0;
                      for (size_t d = shape.size() - 1; d-- > 0;) {
                        const int64_t index = rest % shape[d];
                        rest /= shape[d];
                        ia += index * sa[d];
                        ib += index * sb[d];
                      }
                      const T* const from_a = a.data<T>() + ia;
                      const T* const from_b = b.data<T>() + ib;
                      T* const to = c.data<T>() + row * columns;
                      for (int64_t j = 0; j < columns; ++j)
                        to[j] = f(from_a[j * sa.back()], from_b[j * sb.back()]);
                    }
                  });
}

template <class F>
Tensor broadcast(std::string_view operation, const Tensor& a, const Tensor& b, const F& f) {
  Tensor c(broadcast_shape(operation, a, b), a.dtype());
  if (a.sites() && a.shape() == b.shape()) {
    c.set_sites(common_sites(operation, std::vector{a, b}));
  } else if (a.sites() || b.sites()) {
    const Tensor& image = a.sites() ? a : b;
    if (image.shape() == c.shape()) c.set_sites(image.sites());
  }
  dispatch_floating(operation, a.dtype(), [&]<class T>() { broadcast_map<T>(a, b, c, f); });
  return c;
}

/// Sums a broadcast gradient back to the shape of the operand that was repeated.
Tensor reduce_to(const Tensor& grad, const Shape& shape) {
  if (grad.shape() == shape) return grad;
  Tensor result = grad;
  while (result.dim() > static_cast<int64_t>(shape.size())) result = sum(result, 0);
  for (int64_t d = 0; d < result.dim(); ++d) {
    if (shape[static_cast<size_t>(d)] == 1 && result.size(d) != 1) result = sum(result, d, true);
  }
  return result;
}

}  // namespace

Tensor add(const Tensor& a, const Tensor& b) {
  const Tensor c = broadcast("add", a, b, []<class T>(T p, T q) { return p + q; });
  if (!should_record({&a, &b})) return c;
  const auto gradient = [sa = a.shape(), sb = b.shape()](const Tensor& dc, std::span<const char> needs) {
    return std::vector<Tensor>{needs[0] ? reduce_to(dc, sa) : Tensor(),
                               needs[1] ? reduce_to(dc, sb) : Tensor()};
  };
  // Two tensors in place of one are worth keeping only where one of them is made again itself.
  if (!a.recomputes() && !b.recomputes()) return record("add", c, {a, b}, gradient);
  return record("add", c, {a, b}, gradient,
                [p = a.saved(), q = b.saved()] { return add(p.restored(), q.restored()); });
}

Tensor sub(const Tensor& a, const Tensor& b) {
  const Tensor c = broadcast("sub", a, b, []<class T>(T p, T q) { return p - q; });
  if (!should_record({&a, &b})) return c;
  return record("sub", c, {a, b},
                [sa = a.shape(), sb = b.shape()](const Tensor& dc, std::span<const char> needs) {
                  return std::vector<Tensor>{needs[0] ? reduce_to(dc, sa) : Tensor(),
                                             needs[1] ? reduce_to(affine(dc, -1.0), sb) : Tensor()};
                });
}

Tensor mul(const Tensor& a, const Tensor& b) {
  const Tensor c = broadcast("mul", a, b, []<class T>(T p, T q) { return p * q; });
  if (!should_record({&a, &b})) return c;
  return record("mul", c, {a, b},
                [a = a.detach(), b = b.detach()](const Tensor& dc, std::span<const char> needs) {
                  return std::vector<Tensor>{needs[0] ? reduce_to(mul(dc, b), a.shape()) : Tensor(),
                                             needs[1] ? reduce_to(mul(dc, a), b.shape()) : Tensor()};
                });
}

Tensor div(const Tensor& a, const Tensor& b) {
  const Tensor c = broadcast("div", a, b, []<class T>(T p, T q) { return p / q; });
  if (!should_record({&a, &b})) return c;
  return record(
      "div", c, {a, b},
      [c = c.detach(), b = b.detach(), shape = a.shape()](const Tensor& dc, std::span<const char> needs) {
        // c / b first, as PyTorch: dc / b may overflow where the product does not, and be NaN for c = 0.
        return std::vector<Tensor>{
            needs[0] ? reduce_to(div(dc, b), shape) : Tensor(),
            needs[1] ? reduce_to(affine(mul(dc, div(c, b)), -1.0), b.shape()) : Tensor()};
      });
}

Tensor affine(const Tensor& a, double scale, double offset) {
  return pointwise(
      "affine", a, Saved::kInput,
      [scale, offset]<class T>(T v) { return v * static_cast<T>(scale) + static_cast<T>(offset); },
      [scale]<class T>(T dy, T) { return dy * static_cast<T>(scale); });
}

}  // namespace opaline
