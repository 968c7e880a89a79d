// Training: two stages from one config, with checkpoints from which a run goes on bitwise as if it had never
// stopped.
#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <optional>

#include "core/progress.h"
#include "data/dataset.h"
#include "train/config.h"
#include "train/run_folder.h"

namespace opaline {

struct TrainerOptions {
  RunFolder run;
  ProgressOptions progress = default_progress();
  /// Scenes to train on; not set: the data set at the config's data.path.
  std::shared_ptr<const Dataset> dataset = {};
  /// Asked after every step with the number of steps done: a signal's number ends the run after saving it.
  /// Not set: SIGINT and SIGTERM.
  std::function<int(int64_t step)> interrupted = {};
  /// resume_training: goes on although the config or the data set has changed.
  bool force = false;
  /// resume_training: the checkpoint to go on from; not set: the newest that is whole.
  std::optional<std::filesystem::path> from = {};
};

struct TrainResult {
  int64_t step = 0;  ///< optimiser steps done, both stages together
  int signal = 0;    ///< that ended the run; 0: it is complete
};

/// Trains in a run folder that holds no checkpoint yet; the config is saved there. Throws UsageError where
/// the folder holds a run; Error where the loss or a gradient is not finite: the message names the layer and
/// the scenes, and RUN/failures/step-N has a checkpoint of the state before that step (resume with `from` it
/// to replay) beside the batch and what was found.
TrainResult start_training(const RunConfig& config, const TrainerOptions& options);

/// Goes on from a checkpoint of the run folder. Throws UsageError with the difference where the config or the
/// data set is not the one the checkpoint was made with, unless forced.
TrainResult resume_training(const RunConfig& config, const TrainerOptions& options);

}  // namespace opaline
