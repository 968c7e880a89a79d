// A trained cascade out of a run folder, for evaluation, prediction and reports.
#pragma once

#include <memory>
#include <string>
#include <vector>

#include "models/cascade.h"
#include "train/checkpoint.h"
#include "train/config.h"
#include "train/run_folder.h"

namespace opaline {

struct TrainedModel {
  RunConfig config;
  TrainingState state;
  std::filesystem::path checkpoint;  ///< folder the weights came from
  std::unique_ptr<Cascade> cascade;  ///< in evaluation mode, without the reconstruction network
};

/// From the newest checkpoint that is whole. `networks` are those to read (others keep their zero weights, so
/// do not run them); empty means all but the reconstruction. Throws Error where one of them is not there.
TrainedModel load_trained_model(const RunFolder& run, const Warn& warn,
                                std::vector<std::string> networks = {});

}  // namespace opaline
