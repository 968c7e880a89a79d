#include <cmath>

#include "core/check/reference.h"

namespace opaline::check::reference {
namespace {

/// Mean and biased variance of `count` values from `first` on, `stride` apart, in two passes.
struct Moments {
  double mean = 0.0, variance = 0.0;

  Moments(const Array& x, int64_t first, int64_t stride, int64_t count) {
    for (int64_t i = 0; i < count; ++i) mean += x[first + i * stride];
    mean /= static_cast<double>(count);
    for (int64_t i = 0; i < count; ++i) {
      const double d = x[first + i * stride] - mean;
      variance += d * d;
    }
    variance /= static_cast<double>(count);
  }
};

}  // namespace

Array layer_norm(const Array& x, const Array& weight, const Array& bias, double eps) {
  const int64_t columns = x.last();
  Array y(x.shape);
  for (int64_t row = 0; row < x.count() / columns; ++row) {
    const Moments m(x, row * columns, 1, columns);
    for (int64_t j = 0; j < columns; ++j) {
      y[row * columns + j] =
          (x[row * columns + j] - m.mean) / std::sqrt(m.variance + eps) * weight[j] + bias[j];
    }
  }
  return y;
}

BatchNormResult batch_norm(const Array& x, const Array& weight, const Array& bias, const Array& running_mean,
                           const Array& running_var, bool training, double momentum, double eps) {
  const int64_t columns = x.last(), rows = x.count() / columns;
  BatchNormResult result{Array(x.shape), running_mean, running_var};
  for (int64_t j = 0; j < columns; ++j) {
    double mean = 0.0, variance = 0.0;
    if (training) {
      const Moments m(x, j, columns, rows);
      mean = m.mean;
      variance = m.variance;
      if (running_mean.count() > 0) {
        const auto n = static_cast<double>(rows);
        result.running_mean[j] = (1.0 - momentum) * running_mean[j] + momentum * mean;
        if (rows > 1) {
          result.running_var[j] = (1.0 - momentum) * running_var[j] + momentum * variance * n / (n - 1.0);
        }
      }
    } else {
      mean = running_mean[j];
      variance = running_var[j];
    }
    for (int64_t i = 0; i < rows; ++i) {
      result.y[i * columns + j] =
          (x[i * columns + j] - mean) / std::sqrt(variance + eps) * weight[j] + bias[j];
    }
  }
  return result;
}

Array instance_norm(const Array& x, const std::optional<Array>& weight, const std::optional<Array>& bias,
                    double eps) {
  const int64_t pixels = x.size(1) * x.size(2), columns = x.size(3);
  Array y(x.shape);
  for (int64_t image = 0; image < x.size(0); ++image) {
    for (int64_t j = 0; j < columns; ++j) {
      const int64_t first = image * pixels * columns + j;
      const Moments m(x, first, columns, pixels);
      for (int64_t i = 0; i < pixels; ++i) {
        y[first + i * columns] =
            (x[first + i * columns] - m.mean) / std::sqrt(m.variance + eps) * (weight ? (*weight)[j] : 1.0) +
            (bias ? (*bias)[j] : 0.0);
      }
    }
  }
  return y;
}

}  // namespace opaline::check::reference
