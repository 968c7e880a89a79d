// Checking a data set: that every scene reads, and that what it holds is what scenes hold.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "data/dataset.h"

namespace opaline {

/// Evidence for the frame of normals and depth, as sums over pixels; sums of scenes add up.
struct FrameEvidence {
  /// Just inside silhouettes: outward direction (x right, y up) times the normal's direction in the image,
  /// per axis, and the number of pixels. Near +0.5 and +0.5 of it where both axes are as ours.
  double outward_x = 0;
  double outward_y = 0;
  double silhouette = 0;
  /// Depth differences to the right and upward against -nx / nz and -ny / nz: products and squares.
  double slope_x = 0;
  double slope_y = 0;
  double slope_x_scale = 0;  ///< product of the root sums of squares, summed over scenes
  double slope_y_scale = 0;
};

/// What the evidence says.
struct FrameMatch {
  bool known = false;       ///< enough pixels, and no axis is ambiguous
  bool flip_x = false;      ///< normals' x points left
  bool flip_y = false;      ///< normals' y points down
  bool flip_depth = false;  ///< larger depth is farther
  double silhouette = 0;    ///< mean cosine between outward and the normal after the flips
  double slope = 0;         ///< correlation of depth's slope with the normals' after the flips
  bool ours() const { return known && !flip_x && !flip_y && !flip_depth; }
};

FrameMatch match_frame(const FrameEvidence& evidence);
/// "x right, y up, larger depth is nearer (silhouettes 0.95, slopes 0.99)".
std::string to_string(const FrameMatch& match);

/// One scene's findings.
struct SceneCheck {
  std::string id;
  std::string problem;  ///< why it cannot be used; empty where it can
  std::vector<std::string> warnings;
  double coverage = 0;
  double mean_light = 0;            ///< of S0 / 2 on the object
  double clipped = 0;               ///< share of the object's polariser values over white
  double over_polarised = 0;        ///< share of the object's values whose DoP exceeds 1
  double mean_dop = 0;              ///< on the object
  std::optional<float> pair_ratio;  ///< of a capture (data/scene.h)
  /// g, sigma_t (3), albedo (3), flash; empty where the layout has none.
  std::vector<double> parameters;
  FrameEvidence frame;
};

/// Loads the scene and looks at all it has. Never throws for what the scene holds.
SceneCheck check_scene(const Dataset& dataset, Split split, int64_t index);

struct SplitCheck {
  Split split = Split::kTrain;
  std::vector<SceneCheck> scenes;
};

struct DatasetCheck {
  DatasetFacts facts;
  std::vector<std::string> problems;  ///< of the set as a whole
  std::vector<std::string> warnings;  ///< likewise
  std::vector<SplitCheck> splits;     ///< those that have scenes
  FrameMatch frame;

  /// No problem, neither of the set nor of a scene.
  bool sound() const;
};

/// Every scene of every split, on all threads.
DatasetCheck check_dataset(const Dataset& dataset);

/// The findings as text, a line each, the first `max_problems` problems of scenes among them.
std::string to_text(const DatasetCheck& check, size_t max_problems = 20);

}  // namespace opaline
