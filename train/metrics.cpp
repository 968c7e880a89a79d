#include "train/metrics.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "core/random.h"

namespace opaline {
namespace {

constexpr int kResamples = 1000;
// sigma_t is judged as a share of its range, per metre.
constexpr double kSigmaTUnit = 32.0;

double mean_absolute(const std::array<float, 3>& a, const std::array<float, 3>& b) {
  double sum = 0.0;
  for (size_t i = 0; i < a.size(); ++i)
    sum += std::abs(static_cast<double>(a[i]) - static_cast<double>(b[i]));
  return sum / static_cast<double>(a.size());
}

/// Mean of f(pixel) over the mask; 0 where it is empty.
template <class F>
double masked_mean(std::span<const float> mask, const F& f) {
  double sum = 0.0;
  int64_t count = 0;
  for (size_t i = 0; i < mask.size(); ++i) {
    if (!(mask[i] > 0.5F)) continue;
    sum += f(i);
    ++count;
  }
  return count > 0 ? sum / static_cast<double>(count) : 0.0;
}

/// Maps values to [0, 1] by their range inside the mask.
struct MinMax {
  double low = std::numeric_limits<double>::infinity();
  double high = -std::numeric_limits<double>::infinity();

  MinMax(std::span<const float> values, std::span<const float> mask) {
    for (size_t i = 0; i < mask.size(); ++i) {
      if (!(mask[i] > 0.5F)) continue;
      low = std::min(low, static_cast<double>(values[i]));
      high = std::max(high, static_cast<double>(values[i]));
    }
  }
  double operator()(float value) const {
    const double above =
        static_cast<double>(value) - low;  // 0 in a constant map; NaN, which min and max skip, stays
    return high > low ? above / (high - low) : above;
  }
};

}  // namespace

double normal_error(std::span<const float> estimate, std::span<const float> truth,
                    std::span<const float> mask) {
  return masked_mean(mask, [&](size_t i) {
    double sum = 0.0;
    for (size_t c = 3 * i; c < 3 * i + 3; ++c) {
      sum += std::abs(static_cast<double>(estimate[c]) - static_cast<double>(truth[c])) / 2.0;
    }
    return sum / 3.0;
  });
}

double mean_angle_degrees(std::span<const float> estimate, std::span<const float> truth,
                          std::span<const float> mask) {
  return masked_mean(mask, [&](size_t i) {
    const std::array<double, 3> a = {estimate[3 * i], estimate[3 * i + 1], estimate[3 * i + 2]};
    const std::array<double, 3> b = {truth[3 * i], truth[3 * i + 1], truth[3 * i + 2]};
    const double dot = a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
    const double x = a[1] * b[2] - a[2] * b[1];
    const double y = a[2] * b[0] - a[0] * b[2];
    const double z = a[0] * b[1] - a[1] * b[0];
    const double cross = std::sqrt(x * x + y * y + z * z);
    // atan2 stays accurate at small angles, where acos of the dot product does not.
    if (dot == 0.0 && cross == 0.0) return 90.0;
    return std::atan2(cross, dot) * 180.0 / std::numbers::pi;
  });
}

double depth_error_min_max(std::span<const float> estimate, std::span<const float> truth,
                           std::span<const float> mask) {
  const MinMax map_estimate(estimate, mask);
  const MinMax map_truth(truth, mask);
  return masked_mean(mask,
                     [&](size_t i) { return std::abs(map_estimate(estimate[i]) - map_truth(truth[i])); });
}

double depth_error_aligned(std::span<const float> estimate, std::span<const float> truth,
                           std::span<const float> mask) {
  const double mean_x = masked_mean(mask, [&](size_t i) { return static_cast<double>(estimate[i]); });
  const double mean_y = masked_mean(mask, [&](size_t i) { return static_cast<double>(truth[i]); });
  const double var = masked_mean(mask, [&](size_t i) {
    const double d = estimate[i] - mean_x;
    return d * d;
  });
  const double cov =
      masked_mean(mask, [&](size_t i) { return (estimate[i] - mean_x) * (truth[i] - mean_y); });
  const double scale = var == 0.0 ? 0.0 : cov / var;  // a constant estimate has only its shift; NaN stays
  return masked_mean(mask,
                     [&](size_t i) { return std::abs(scale * (estimate[i] - mean_x) + mean_y - truth[i]); });
}

Metrics measure(const SceneValues& estimate, const SceneValues& truth, std::span<const float> mask) {
  const auto at = [](Metric metric) { return static_cast<size_t>(metric); };
  Metrics result;
  if (!estimate.normal.empty()) {
    result[at(Metric::kNormal)] = normal_error(estimate.normal, truth.normal, mask);
    result[at(Metric::kAngularDegrees)] = mean_angle_degrees(estimate.normal, truth.normal, mask);
  }
  if (!estimate.depth.empty()) {
    result[at(Metric::kDepth)] = depth_error_min_max(estimate.depth, truth.depth, mask);
    result[at(Metric::kDepthAligned)] = depth_error_aligned(estimate.depth, truth.depth, mask);
  }
  if (estimate.sss && truth.sss) {
    result[at(Metric::kSigmaT)] = mean_absolute(estimate.sss->sigma_t, truth.sss->sigma_t) / kSigmaTUnit;
    result[at(Metric::kAlbedo)] = mean_absolute(estimate.sss->albedo, truth.sss->albedo);
    result[at(Metric::kG)] =
        std::abs(static_cast<double>(estimate.sss->g) - static_cast<double>(truth.sss->g));
  }
  return result;
}

Metrics mean_metrics(std::span<const Metrics> scenes) {
  Metrics result;
  if (scenes.empty()) return result;
  for (size_t m = 0; m < kMetricCount; ++m) {
    double sum = 0.0;
    bool everywhere = true;
    for (const Metrics& scene : scenes) {
      everywhere = everywhere && scene[m].has_value();
      sum += scene[m].value_or(0.0);
    }
    if (everywhere) result[m] = sum / static_cast<double>(scenes.size());
  }
  return result;
}

Interval bootstrap_interval(std::span<const double> values, uint64_t seed) {
  if (values.empty()) return {};
  const auto n = static_cast<uint32_t>(values.size());
  std::vector<double> means(kResamples);
  for (uint32_t r = 0; r < kResamples; ++r) {
    Random random(seed, Purpose::kBootstrap, 0, r);
    double sum = 0.0;
    for (uint32_t i = 0; i < n; ++i) sum += values[random.below(n)];
    means[r] = sum / n;
  }
  std::sort(means.begin(), means.end());
  // 2.5 % of the resamples lie below the one and above the other.
  return {.low = means[kResamples / 40], .high = means[kResamples - 1 - kResamples / 40]};
}

}  // namespace opaline
