// One stage of training: the cascade, its optimiser and a step of both. What a run is made of, without
// folders, logs or signals.
#pragma once

#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "data/encode.h"
#include "models/cascade.h"
#include "nn/optim.h"
#include "train/config.h"

namespace opaline {

/// Where a step went wrong.
struct StepFailure {
  std::string what;   ///< "the loss is nan", "the gradient of .. is not finite"
  std::string layer;  ///< first layer, parameter or tensor of the batch that is not finite
  std::vector<std::string> scenes;
  Batch batch;  ///< the micro-batch at fault; of a gradient: the last one
};

struct StepOutcome {
  int64_t images = 0;
  std::map<std::string, double> losses;  ///< means over the step's images: each term unweighted, and "total"
  double gradient_norm = 0.0;
  std::optional<StepFailure>
      failure;  ///< weights, moments and running statistics are then as before the step
};

/// What a loss is computed from, out of a batch.
LossTargets loss_targets(const Batch& batch);

class Stage {
 public:
  /// Freshly drawn weights (networks of an earlier stage are taken over by restore() or take_over()) and zero
  /// moments. Throws UsageError where nothing is left to train.
  Stage(const RunConfig& config, int stage);

  int number() const { return number_; }
  Cascade& cascade() { return cascade_; }
  const Cascade& cascade() const { return cascade_; }
  Adam& adam() { return *adam_; }
  const Adam& adam() const { return *adam_; }

  /// Copies the weights and running statistics of the networks that both have.
  void take_over(const Cascade& earlier);

  /// One optimiser step over micro-batches. The loss of each is weighted by its share of the images, so the
  /// gradient is that of the mean over all of them (batch statistics are each micro-batch's own).
  /// `next` gives micro-batches of these sizes; only one is held at a time.
  StepOutcome step(std::span<const int64_t> sizes, const std::function<Batch()>& next, double rate_factor);

  /// Training mode, except for frozen networks.
  void set_training();

 private:
  std::optional<StepFailure> run_micro_batch(const Batch& batch, double share, StepOutcome& outcome);

  int number_;
  LossOptions loss_;
  std::vector<std::string> frozen_;
  Cascade cascade_;
  std::unique_ptr<Adam> adam_;
};

}  // namespace opaline
