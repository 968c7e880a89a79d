// What the results are judged by, scene by scene.
//
// Two sets. "Release" follows the authors' implementation: normals compared after mapping to [0, 1], neither
// normalised nor clamped; depth after an independent min-max of prediction and truth inside the mask; sigma_t
// in its normalised unit (physical / 32), albedo and g in their own. "Honest" ones say what is left when no
// scale hides it: the angle between normals, and the depth error after one scale and shift.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "data/encode.h"

namespace opaline {

/// One scene's maps, row-major. Neither the normal nor the depth need any particular scale. What is empty is
/// not measured.
struct SceneValues {
  std::span<const float> normal;  ///< H x W x 3
  std::span<const float> depth;   ///< H x W
  std::optional<SssValues> sss;   ///< in physical units; absent from a stage-1 cascade
};

enum class Metric { kNormal, kDepth, kSigmaT, kAlbedo, kG, kAngularDegrees, kDepthAligned };
inline constexpr int kMetricCount = 7;
inline constexpr std::array<std::string_view, kMetricCount> kMetricNames = {
    "normal", "depth", "sigma_t", "albedo", "g", "angular_degrees", "depth_aligned"};
/// The first five are the columns of the paper's table.
inline constexpr int kReleaseMetricCount = 5;

/// Metrics of one scene, or their means; absent where there is nothing to measure: no such estimate.
using Metrics = std::array<std::optional<double>, kMetricCount>;

/// Mean over mask pixels and channels of |a - b| / 2: both mapped from [-1, 1] to [0, 1]. Empty mask: 0.
double normal_error(std::span<const float> estimate, std::span<const float> truth,
                    std::span<const float> mask);
/// Mean angle in degrees between the normalised vectors over the mask. A zero vector counts as 90 degrees.
double mean_angle_degrees(std::span<const float> estimate, std::span<const float> truth,
                          std::span<const float> mask);
/// Each map to [0, 1] by its own minimum and maximum inside the mask (a constant map becomes 0), then the
/// mean absolute difference over the mask.
double depth_error_min_max(std::span<const float> estimate, std::span<const float> truth,
                           std::span<const float> mask);
/// Mean over the mask of |a x + b - truth|, with a and b by least squares; in the unit of the truth.
double depth_error_aligned(std::span<const float> estimate, std::span<const float> truth,
                           std::span<const float> mask);

/// All metrics of one scene. `mask` is H x W of zeros and ones.
Metrics measure(const SceneValues& estimate, const SceneValues& truth, std::span<const float> mask);

/// Mean over the scenes; absent where any scene lacks it.
Metrics mean_metrics(std::span<const Metrics> scenes);

struct Interval {
  double low = 0.0;
  double high = 0.0;
};

/// 95 % interval of the mean by the percentile bootstrap over scenes (Efron 1979), 1000 resamples keyed by
/// seed.
Interval bootstrap_interval(std::span<const double> values, uint64_t seed = 0);

}  // namespace opaline
