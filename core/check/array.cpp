#include "core/check/array.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace opaline::check {

Array::Array(const Tensor& tensor) : Array(tensor.shape()) {
  for (int64_t i = 0; i < tensor.numel(); ++i) (*this)[i] = tensor.at(i);
}

double largest_magnitude(const Array& array) {
  double largest = 0.0;
  for (const double value : array.values) {
    if (std::isfinite(value)) largest = std::max(largest, std::abs(value));
  }
  return largest;
}

double relative_error(const Array& actual, const Array& expected, double floor) {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  if (actual.shape != expected.shape) return kInfinity;
  const double largest = std::max(largest_magnitude(expected), floor);
  const double scale = largest > 0.0 ? largest : 1.0;
  double worst = 0.0;
  for (int64_t i = 0; i < expected.count(); ++i) {
    const double a = actual[i], e = expected[i];
    if (!std::isfinite(e)) {
      if (a == e || (std::isnan(a) && std::isnan(e))) continue;
      return kInfinity;
    }
    const double error = std::abs(a - e) / scale;
    if (!(error <= worst)) worst = error;
    if (std::isnan(error)) return kInfinity;
  }
  return worst;
}

void include_error(double& worst, double error) {
  if (!std::isnan(worst) && !(error <= worst)) worst = error;
}

}  // namespace opaline::check
