#include <algorithm>
#include <cmath>

#include "core/check/reference.h"

namespace opaline::check::reference {
namespace {

Array scalar(double value) {
  Array y{Shape{}};
  y[0] = value;
  return y;
}

/// Mean over images of the mean over a mask's pixels of loss(first element of the pixel).
Array masked_mean(const Array& x, const Array& mask, const std::function<double(int64_t)>& loss) {
  const int64_t images = x.size(0), pixels = x.size(1) * x.size(2), channels = x.size(3);
  double total = 0.0;
  for (int64_t n = 0; n < images; ++n) {
    double sum = 0.0, count = 0.0;
    for (int64_t i = n * pixels; i < (n + 1) * pixels; ++i) {
      if (mask[i] == 0.0) continue;
      sum += loss(i * channels);
      count += 1.0;
    }
    if (count > 0.0) total += sum / count;
  }
  return scalar(total / static_cast<double>(images));
}

}  // namespace

Array masked_l1_loss(const Array& x, const Array& target, const Array& mask) {
  return masked_mean(x, mask, [&](int64_t first) {
    double total = 0.0;
    for (int64_t k = 0; k < x.last(); ++k) total += std::abs(x[first + k] - target[first + k]);
    return total / static_cast<double>(x.last());
  });
}

Array masked_mse_loss(const Array& x, const Array& target, const Array& mask) {
  return masked_mean(x, mask, [&](int64_t first) {
    double total = 0.0;
    for (int64_t k = 0; k < x.last(); ++k) total += std::pow(x[first + k] - target[first + k], 2.0);
    return total / static_cast<double>(x.last());
  });
}

Array cosine_loss(const Array& x, const Array& target, const Array& mask) {
  return masked_mean(x, mask, [&](int64_t first) {
    double dot = 0.0, xx = 0.0, tt = 0.0;
    for (int64_t k = 0; k < x.last(); ++k) {
      dot += x[first + k] * target[first + k];
      xx += x[first + k] * x[first + k];
      tt += target[first + k] * target[first + k];
    }
    const double product = std::sqrt(xx) * std::sqrt(tt);
    return 1.0 - dot / (product < 1e-8 ? 1e-8 : product);
  });
}

Array l1_loss(const Array& x, const Array& target) {
  double total = 0.0;
  for (int64_t i = 0; i < x.count(); ++i) total += std::abs(x[i] - target[i]);
  return scalar(total / static_cast<double>(x.count()));
}

Array mse_loss(const Array& x, const Array& target) {
  double total = 0.0;
  for (int64_t i = 0; i < x.count(); ++i) total += (x[i] - target[i]) * (x[i] - target[i]);
  return scalar(total / static_cast<double>(x.count()));
}

}  // namespace opaline::check::reference
