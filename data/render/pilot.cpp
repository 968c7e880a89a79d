#include "data/render/pilot.h"

#include <algorithm>
#include <cmath>

namespace opaline::render {
namespace {

/// S0 of white: images are clipped there.
constexpr double kWhite = 2.0;

/// Variance of the degree of polarisation, to first order, of a pixel of this mean whose Stokes components
/// have these covariances.
template <class F>
double dop_variance(const Rgb& mean, const F& covariance) {
  // DoP = |(S1, S2)| / S0 along its direction (or the mean over directions where there is none).
  const double length = std::hypot(mean[1], mean[2]), dop = length / mean[0];
  const double u1 = length > 0.0 ? mean[1] / length : std::sqrt(0.5);
  const double u2 = length > 0.0 ? mean[2] / length : std::sqrt(0.5);
  const double variance = u1 * u1 * covariance(1, 1) + u2 * u2 * covariance(2, 2) +
                          2.0 * u1 * u2 * covariance(1, 2) + dop * dop * covariance(0, 0) -
                          2.0 * dop * (u1 * covariance(0, 1) + u2 * covariance(0, 2));
  return std::max(0.0, variance) / (mean[0] * mean[0]);
}

}  // namespace

void LightPilot::add(const Splat& splat) {
  for (size_t c = 0; c < 3; ++c) {
    std::array<double, 3> light{};
    for (size_t i = 0; i < 3; ++i) light[i] = double{splat.rows[i]} * double{splat.light[c]};
    for (size_t i = 0; i < 3; ++i) {
      sum_[i][c] += light[i];
      for (size_t j = 0; j < 3; ++j) product_[c][i][j] += light[i] * light[j];
    }
  }
}

void LightPilot::add(const LightPilot& other) {
  for (size_t c = 0; c < 3; ++c) {
    for (size_t i = 0; i < 3; ++i) {
      sum_[i][c] += other.sum_[i][c];
      for (size_t j = 0; j < 3; ++j) product_[c][i][j] += other.product_[c][i][j];
    }
  }
}

void CameraPilot::add(const PathSample& sample) {
  ++count_;
  if (!sample.hit) return;
  ++hits_;
  // The mirror part is what is reflected without further events; it comes with the unscattered part's
  // variance where more follow.
  const std::array<StokesRgb, kPixelParts> parts = {sample.reflected, sample.unscattered, sample.scattered};
  for (size_t p = 0; p < kPixelParts; ++p) {
    for (size_t c = 0; c < 3; ++c) {
      for (size_t i = 0; i < 3; ++i) {
        sum_[p][i][c] += parts[p][i][c];
        for (size_t j = 0; j < 3; ++j) product_[p][c][i][j] += parts[p][i][c] * parts[p][j][c];
      }
    }
  }
}

PixelPilot CameraPilot::result(const LightPilot& light, const LightPilot& around, double pixels_around,
                               int64_t paths) const {
  PixelPilot pilot{.object = hits_ > 0, .whole = hits_ == count_};
  if (hits_ == 0) return pilot;
  const auto n = static_cast<double>(count_);
  const auto light_paths = static_cast<double>(std::max<int64_t>(paths, 1));
  for (size_t c = 0; c < 3; ++c) {
    Rgb mean{};
    for (size_t i = 0; i < 3; ++i) {
      for (size_t p = 0; p < kPixelParts; ++p) mean[i] += sum_[p][i][c] / n;
      mean[i] += around.mean(i, c, light_paths * pixels_around);
    }
    pilot.light += std::min(mean[0], kWhite) / 3.0;
    if (mean[0] > kWhite || !(mean[0] > 0.0)) continue;
    for (size_t p = 0; p < kPixelParts; ++p) {
      const auto covariance = [&](size_t i, size_t j) {
        return product_[p][c][i][j] / n - sum_[p][i][c] / n * (sum_[p][j][c] / n);
      };
      pilot.s0[p] += std::max(0.0, covariance(0, 0)) / 3.0;
      pilot.dop[p] += dop_variance(mean, covariance) / 3.0;
    }
    // One path brings a pixel little: its variance is its second moment.
    const auto moment = [&](size_t i, size_t j) { return light.second_moment(c, i, j, light_paths); };
    pilot.light_path_s0 += moment(0, 0) / 3.0;
    pilot.light_path_dop += dop_variance(mean, moment) / 3.0;
  }
  return pilot;
}

}  // namespace opaline::render
