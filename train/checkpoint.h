// Checkpoints: RUN/checkpoints/step-N/ with one safetensors file a network (`normal.safetensors`, ..),
// `optimizer.safetensors` and `state.json`. A checkpoint is written under a temporary name, synced and
// renamed, so a folder named step-N is whole; `state.json` holds the XXH64 of every file and of itself, so a
// flipped bit is found.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <string>
#include <string_view>
#include <vector>

#include "core/safetensors.h"
#include "models/cascade.h"
#include "nn/optim.h"

namespace opaline {

/// Where a run stands: everything, besides weights and moments, that the next step depends on. Random numbers
/// are keyed by these counters and have no state of their own.
struct TrainingState {
  int stage = 1;
  int64_t epoch = 0;       ///< of the stage, from 0
  int64_t batch = 0;       ///< batches of this epoch that are done
  int64_t step = 0;        ///< optimiser steps, both stages together
  int64_t stage_step = 0;  ///< optimiser steps of this stage
  int64_t log_lines = 0;   ///< lines of metrics.jsonl that belong to the steps done
  /// Running sums of this epoch for its line in the log: loss terms weighted by images, and `images`.
  std::map<std::string, double> epoch_sums;
  std::string config;  ///< resolved TOML (train/config.h)
  std::string data;    ///< fingerprint of the data set (data/dataset.h)
};

struct Checkpoint {
  std::filesystem::path folder;
  TrainingState state;
  std::map<std::string, TensorMap> networks;  ///< parameters and buffers by network name
  TensorMap optimizer;
};

/// Called with a line of text when something was wrong, but could be worked around.
using Warn = std::function<void(std::string_view)>;

/// Writes `parent`/step-N and returns it. Where that exists it is replaced.
std::filesystem::path save_checkpoint(const std::filesystem::path& parent, const TrainingState& state,
                                      const Cascade& cascade, const Adam& adam);

/// Folders step-N in `parent`, newest (largest N) first.
std::vector<std::filesystem::path> list_checkpoints(const std::filesystem::path& parent);

/// Removes all but the newest `keep`, and what an interrupted write has left.
void prune_checkpoints(const std::filesystem::path& parent, int64_t keep);

struct LoadCheckpointOptions {
  /// Networks to read; empty means all that there are. Names that the checkpoint lacks are left out.
  std::vector<std::string> networks = {};
  bool optimizer = true;
};

/// Reads and checks one checkpoint. Throws Error naming the file.
Checkpoint load_checkpoint(const std::filesystem::path& folder, const LoadCheckpointOptions& options = {});

/// The newest checkpoint that is whole; each damaged one on the way is named in a warning. Throws Error where
/// there is none.
Checkpoint load_newest_checkpoint(const std::filesystem::path& parent, const Warn& warn,
                                  const LoadCheckpointOptions& options = {});

/// Gives the cascade's networks the weights of those that the checkpoint has; others stay as they are.
void restore_networks(const Checkpoint& checkpoint, Cascade& cascade);

}  // namespace opaline
