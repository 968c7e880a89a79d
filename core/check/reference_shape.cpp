#include <numeric>

#include "core/check/reference.h"

namespace opaline::check::reference {
namespace {

/// The index of element i, one number a dimension.
std::vector<int64_t> unravel(int64_t i, const Shape& shape) {
  std::vector<int64_t> index(shape.size());
  for (size_t d = shape.size(); d-- > 0;) {
    index[d] = i % shape[d];
    i /= shape[d];
  }
  return index;
}

int64_t ravel(const std::vector<int64_t>& index, const Shape& shape) {
  int64_t i = 0;
  for (size_t d = 0; d < shape.size(); ++d) i = i * shape[d] + index[d];
  return i;
}

}  // namespace

Array sum(const Array& x) {
  Array y{Shape{}};
  y[0] = std::accumulate(x.values.begin(), x.values.end(), 0.0);
  return y;
}

Array mean(const Array& x) {
  Array y = sum(x);
  y[0] /= static_cast<double>(x.count());
  return y;
}

Array sum(const Array& x, size_t axis, bool keepdim) {
  Shape kept = x.shape;
  kept[axis] = 1;
  Array y(kept);
  for (int64_t i = 0; i < x.count(); ++i) {
    std::vector<int64_t> index = unravel(i, x.shape);
    index[axis] = 0;
    y[ravel(index, kept)] += x[i];
  }
  if (!keepdim) y.shape.erase(y.shape.begin() + static_cast<std::ptrdiff_t>(axis));
  return y;
}

Array mean(const Array& x, size_t axis, bool keepdim) {
  Array y = sum(x, axis, keepdim);
  for (double& v : y.values) v /= static_cast<double>(x.shape[axis]);
  return y;
}

Array concat(std::span<const Array> parts, size_t axis) {
  Shape shape = parts[0].shape;
  shape[axis] = 0;
  for (const Array& part : parts) shape[axis] += part.shape[axis];
  Array y(shape);
  int64_t begin = 0;
  for (const Array& part : parts) {
    for (int64_t i = 0; i < part.count(); ++i) {
      std::vector<int64_t> index = unravel(i, part.shape);
      index[axis] += begin;
      y[ravel(index, shape)] = part[i];
    }
    begin += part.shape[axis];
  }
  return y;
}

Array reshape(const Array& x, Shape shape) {
  Array y = x;
  y.shape = std::move(shape);
  return y;
}

Array permute(const Array& x, const std::vector<size_t>& order) {
  Shape shape(order.size());
  for (size_t d = 0; d < order.size(); ++d) shape[d] = x.shape[order[d]];
  Array y(shape);
  for (int64_t i = 0; i < y.count(); ++i) {
    const std::vector<int64_t> index = unravel(i, shape);
    std::vector<int64_t> from(index.size());
    for (size_t d = 0; d < order.size(); ++d) from[order[d]] = index[d];
    y[i] = x[ravel(from, x.shape)];
  }
  return y;
}

Array slice(const Array& x, size_t axis, int64_t begin, int64_t end) {
  Shape shape = x.shape;
  shape[axis] = end - begin;
  Array y(shape);
  for (int64_t i = 0; i < y.count(); ++i) {
    std::vector<int64_t> index = unravel(i, shape);
    index[axis] += begin;
    y[i] = x[ravel(index, x.shape)];
  }
  return y;
}

Array expand(const Array& x, const Shape& shape) {
  Array y(shape);
  const size_t missing = shape.size() - x.shape.size();
  for (int64_t i = 0; i < y.count(); ++i) {
    const std::vector<int64_t> index = unravel(i, shape);
    std::vector<int64_t> from(x.shape.size());
    for (size_t d = 0; d < from.size(); ++d) from[d] = x.shape[d] == 1 ? 0 : index[d + missing];
    y[i] = x[ravel(from, x.shape)];
  }
  return y;
}

}  // namespace opaline::check::reference
