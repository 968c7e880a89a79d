// A cascade's errors over a data set, beside those of predicting the training mean.
#pragma once

#include <array>
#include <functional>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "data/dataset.h"
#include "data/encode.h"
#include "data/loader.h"
#include "models/cascade.h"
#include "train/metrics.h"

namespace opaline {

/// The best predictor that does not look at the image: at each pixel the mean normal of the training scenes
/// that cover it (normalised) and their mean depth, and the mean SSS parameters.
struct MeanPredictor {
  int width = 0;
  int height = 0;
  std::vector<float> normal;  ///< H x W x 3; (0, 0, 1) where no scene is
  std::vector<float> depth;   ///< H x W; the mean of all where no scene is
  std::optional<SssValues> sss;
};

/// From the training split; from `max_scenes` of it, evenly spread, where it has more. Throws Error where it
/// is empty, has no ground truth or scenes of several sizes. Where damage may be skipped, scenes that cannot
/// be read do not count.
MeanPredictor fit_mean_predictor(const Dataset& dataset, int64_t max_scenes = 4000,
                                 DamagePolicy damaged = DamagePolicy::kFail);

/// Groups of columns: what is not asked for is not computed, unless another network needs it.
struct EvaluateColumns {
  bool normal = true;  ///< normal, angular_degrees
  bool depth = true;   ///< depth, depth_aligned
  bool sss = true;     ///< sigma_t, albedo, g; of a stage-2 cascade
};
inline constexpr std::array<std::string_view, 3> kColumnNames = {"normal", "depth", "sss"};
/// From such names; none means all. Throws UsageError on another name.
EvaluateColumns parse_columns(std::span<const std::string> names);

struct EvaluateOptions {
  EvaluateColumns columns = {};
  Split split = Split::kTest;
  int64_t max_scenes = 0;  ///< the first so many; 0: all
  int64_t batch = 8;
  int threads = 1;  ///< that read and encode
  DamagePolicy damaged = DamagePolicy::kFail;
  /// Images as a camera would take them. The draws are the same in every evaluation.
  CaptureOptions capture = {};
  /// Told of each scene that could not be read and is left out.
  std::function<void(std::string_view)> warn = {};
};

struct SceneResult {
  std::string id;
  Metrics cascade{};
  Metrics mean{};  ///< of the mean predictor; empty without one
  std::optional<SssValues> sss_estimate;
  std::optional<SssValues> sss_truth;
};

/// Runs the cascade in evaluation mode over the split and measures every scene; it stays in that mode. `mean`
/// may be null. Columns that are not asked for are absent. Throws Error naming the scene where truth is
/// missing or an output is not finite.
std::vector<SceneResult> evaluate(Cascade& cascade, const std::shared_ptr<const Dataset>& dataset,
                                  const EncodeOptions& encode, const MeanPredictor* mean,
                                  const EvaluateOptions& options = {});

/// Means and their intervals.
struct EvaluationSummary {
  int64_t n = 0;
  Metrics cascade{};
  std::array<std::optional<Interval>, kMetricCount> ci95{};
  Metrics mean_predictor{};
};
EvaluationSummary summarize(const std::vector<SceneResult>& results);

/// {"release": {"normal", "depth", "sigma_t", "albedo", "g"}, "angular_degrees", "depth_aligned"}; null where
/// absent.
nlohmann::ordered_json to_json(const Metrics& metrics);
/// The object of `opaline eval --json`: n, release, angular_degrees, depth_aligned, ci95, mean_predictor.
nlohmann::ordered_json to_json(const EvaluationSummary& summary);
/// A table for people.
std::string format_table(const EvaluationSummary& summary);

}  // namespace opaline
