// Checking a data set of any layout: that every scene reads, and that what it holds is what scenes hold.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "data/check_frame.h"
#include "data/check_light.h"
#include "data/dataset.h"
#include "data/exr.h"

namespace opaline {

/// A scattering parameter and its range, that the networks' targets are mapped from (data/encode.h); outside
/// of it a value still loads.
struct ParameterRange {
  std::string_view name;
  double min;
  double max;
};
/// g, sigma_t (3), albedo (3), flash: the order of SceneCheck::parameters.
const std::vector<ParameterRange>& parameter_ranges();

/// One scene's findings.
struct SceneCheck {
  std::string id;
  std::vector<std::string> problems;  ///< why it cannot, or should not, be used
  std::vector<std::string> warnings;
  bool read = false;  ///< loaded without an error: the numbers below count
  double coverage = 0;
  Window box;                      ///< of the mask
  double mean_light = 0;           ///< of S0 / 2 on the object
  double clipped = 0;              ///< share of the object's polariser values over white
  double over_polarised = 0;       ///< share of the object's values whose DoP exceeds 1
  double mean_dop = 0;             ///< on the object
  double identity = 0;             ///< largest |I0 + I90 - I45 - I135| / S0 of the images made from S0 to S2
  std::optional<PairCheck> pairs;  ///< where four images are stored
  /// Correlation of stored s1, s2 with I0 - I90, I45 - I135.
  std::optional<std::array<double, 2>> stored_signs;
  std::vector<double> parameters;  ///< empty where the layout has none
  FrameEvidence frame;
  SignEvidence signs;
  GammaEvidence gamma;
  std::string light_hash;  ///< xxh64 of the image's values: the same light twice is the same scene twice
};

/// Loads the scene and looks at all it has. Never throws for what the scene holds.
SceneCheck check_scene(const Dataset& dataset, Split split, int64_t index);

struct SplitCheck {
  Split split = Split::kTrain;
  std::vector<SceneCheck> scenes;
};

enum class Verdict { kGood, kUndecided, kWarning, kBad };
std::string_view to_string(Verdict verdict);

/// One line of the page: what was looked at, what it should be, what it is.
struct Finding {
  std::string what;
  std::string expected;
  std::string found;
  Verdict verdict = Verdict::kGood;
};

struct DatasetCheck {
  DatasetFacts facts;
  std::vector<std::string> problems;  ///< of the set as a whole
  std::vector<std::string> warnings;  ///< likewise
  std::vector<SplitCheck> splits;     ///< those that have scenes
  std::vector<Finding> findings;
  FrameMatch frame;
  SignMatch signs;
  GammaMatch gamma;  ///< of layouts of polariser images

  int64_t problem_count() const;
  int64_t warning_count() const;
  /// No problem, neither of the set nor of a scene.
  bool sound() const { return problem_count() == 0; }
};

struct CheckOptions {
  /// Told after each scene how many of how many are done; one call at a time.
  std::function<void(int64_t done, int64_t total)> progress = [](int64_t, int64_t) {};
};

/// Every scene of every split, on all threads. Files and checksums, the four images against each other,
/// angles, signs and gamma against those declared, frame of normals and depth, mask, saturation, parameters,
/// scenes that are there twice, objects and environments that both splits have.
DatasetCheck check_dataset(const Dataset& dataset, const CheckOptions& options = {});

/// The findings for a terminal, with the first `max_problems` problems and warnings of scenes.
std::string to_text(const DatasetCheck& check, size_t max_problems = 20);
/// Everything, a number where there is one, as JSON.
std::string to_json(const DatasetCheck& check);

}  // namespace opaline
