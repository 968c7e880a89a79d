#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/check/reference.h"

namespace opaline::check::reference {

Array map(const Array& x, const std::function<double(double)>& f) {
  Array y(x.shape);
  for (int64_t i = 0; i < x.count(); ++i) y[i] = f(x[i]);
  return y;
}

double relu(double x) {
  return std::isnan(x) ? x : std::max(x, 0.0);
}

double leaky_relu(double x, double slope) {
  return x > 0.0 ? x : slope * x;
}

double gelu(double x) {
  return 0.5 * x * std::erfc(-x / std::numbers::sqrt2);
}

double tanh(double x) {
  const double below = std::expm1(-2.0 * std::abs(x));  // exp(..) - 1 without losing the digits of a small x
  return std::copysign(1.0, x) * -below / (2.0 + below);
}

double sigmoid(double x) {
  return 1.0 / (1.0 + std::exp(-x));
}

double safe_sqrt(double x) {
  return x <= 0.0 ? 0.0 : std::sqrt(x);
}

double clamp(double x, double low, double high) {
  return std::isnan(x) ? x : std::min(std::max(x, low), high);
}

Array broadcast(const Array& a, const Array& b, const std::function<double(double, double)>& f) {
  const size_t rank = std::max(a.shape.size(), b.shape.size());
  // Both with leading ones up to the same rank.
  const auto padded = [&](const Array& x) {
    Shape shape(rank - x.shape.size(), 1);
    shape.insert(shape.end(), x.shape.begin(), x.shape.end());
    return shape;
  };
  const Shape sa = padded(a), sb = padded(b);
  Shape shape(rank);
  for (size_t d = 0; d < rank; ++d) shape[d] = sa[d] == 1 ? sb[d] : sa[d];
  Array y(shape);
  std::vector<int64_t> index(rank, 0);
  for (int64_t i = 0; i < y.count(); ++i) {
    int64_t rest = i;
    for (size_t d = rank; d-- > 0;) {
      index[d] = rest % shape[d];
      rest /= shape[d];
    }
    int64_t ia = 0, ib = 0;
    for (size_t d = 0; d < rank; ++d) {
      ia = ia * sa[d] + (sa[d] == 1 ? 0 : index[d]);
      ib = ib * sb[d] + (sb[d] == 1 ? 0 : index[d]);
    }
    y[i] = f(a[ia], b[ib]);
  }
  return y;
}

Array softmax(const Array& x) {
  const int64_t columns = x.last();
  Array y(x.shape);
  for (int64_t row = 0; row < x.count() / columns; ++row) {
    const int64_t at = row * columns;
    double largest = x[at];
    for (int64_t j = 0; j < columns; ++j) largest = std::max(largest, x[at + j]);
    double total = 0.0;
    for (int64_t j = 0; j < columns; ++j) total += std::exp(x[at + j] - largest);
    for (int64_t j = 0; j < columns; ++j) y[at + j] = std::exp(x[at + j] - largest) / total;
  }
  return y;
}

Array normalize(const Array& x, double eps) {
  const int64_t columns = x.last();
  Array y(x.shape);
  for (int64_t row = 0; row < x.count() / columns; ++row) {
    const int64_t at = row * columns;
    double squares = 0.0;
    for (int64_t j = 0; j < columns; ++j) squares += x[at + j] * x[at + j];
    const double length = std::sqrt(squares);
    for (int64_t j = 0; j < columns; ++j) y[at + j] = x[at + j] / (length < eps ? eps : length);
  }
  return y;
}

}  // namespace opaline::check::reference
