// Predictions on captures and scenes: maps as EXR and PNG, parameters as JSON.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "data/dataset.h"
#include "train/trained_model.h"

namespace opaline {

/// What can be asked for with `--only`.
struct PredictWanted {
  bool normal = true;
  bool depth = true;
  bool illumination = true;
  bool sss = true;
};

/// From names (normal, depth, illumination, sss); none means all. Throws UsageError on another name.
PredictWanted parse_wanted(const std::vector<std::string>& names);
/// Networks that have to run for it: the SSS network needs all of the others.
std::vector<std::string> networks_for(const PredictWanted& wanted);

/// A scene to predict on: read when its turn comes.
struct PredictInput {
  std::shared_ptr<const Dataset> dataset;
  Split split = Split::kTest;
  int64_t index = 0;
  std::string name;  ///< of its folder in the output
};

/// The scenes behind a path: a capture's folder, a folder of captures, a data set (its test scenes), or one
/// EXR of our data set. Throws Error naming what is missing.
std::vector<PredictInput> open_predict_input(const std::filesystem::path& path);

struct PredictOptions {
  PredictWanted wanted;
  int64_t size = 0;  ///< longer side that captures are scaled down to; 0: as they are
};

/// Writes to OUT/<name>/: input.png; normal.png and depth.png; prediction.exr (normal.X normal.Y normal.Z,
/// depth.Z, mask.A); prediction.json. Returns that folder.
std::filesystem::path predict(const TrainedModel& model, const PredictInput& input,
                              const PredictOptions& options, const std::filesystem::path& out);

}  // namespace opaline
