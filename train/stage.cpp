#include "train/stage.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/autograd.h"
#include "core/error.h"
#include "core/ops/arithmetic.h"
#include "train/diagnose.h"

namespace opaline {
namespace {

/// Copies of all running statistics, to go back to where a step fails.
class BufferSnapshot {
 public:
  explicit BufferSnapshot(Cascade& cascade) {
    for (const std::string& name : cascade.network_names()) {
      for (const NamedTensor& buffer : cascade.network(name).named_buffers()) {
        live_.push_back(buffer.tensor);
        saved_.push_back(buffer.tensor.clone());
      }
    }
  }
  void restore() {
    for (size_t i = 0; i < live_.size(); ++i) live_[i].copy_from(saved_[i]);
  }

 private:
  std::vector<Tensor> live_, saved_;
};

}  // namespace

LossTargets loss_targets(const Batch& batch) {
  return {.mask = batch.mask,
          .normal = batch.normal,
          .depth = batch.depth,
          .illumination = batch.illumination,
          .sss = batch.sss,
          .reconstruction = batch.polarised};
}

Stage::Stage(const RunConfig& config, int stage)
    : number_(stage),
      loss_(config.loss),
      frozen_(config.stages[static_cast<size_t>(stage - 1)].freeze),
      cascade_(cascade_options(config, stage)) {
  cascade_.initialize(config.train.seed);
  std::vector<NamedTensor> trained;
  for (const std::string& name : cascade_.network_names()) {
    Network& network = cascade_.network(name);
    const bool frozen = std::find(frozen_.begin(), frozen_.end(), name) != frozen_.end();
    if (frozen) {
      network.set_requires_grad(false);
      continue;
    }
    for (NamedTensor parameter : network.named_parameters()) {
      parameter.name = name + "." + parameter.name;
      trained.push_back(std::move(parameter));
    }
  }
  if (trained.empty()) {
    fail_usage("train", "stage {}: all of its networks ({}) are frozen, nothing is left to train", stage,
               fmt::join(cascade_.network_names(), ", "));
  }
  adam_ = std::make_unique<Adam>(std::move(trained), adam_options(config, stage));
  set_training();
}

void Stage::set_training() {
  cascade_.set_training(true);
  for (const std::string& name : frozen_) {
    if (cascade_.has(name)) cascade_.network(name).set_training(false);
  }
}

void Stage::take_over(const Cascade& earlier) {
  for (const std::string& name : cascade_.network_names()) {
    if (earlier.has(name)) cascade_.network(name).load_state_dict(earlier.network(name).state_dict());
  }
}

std::optional<StepFailure> Stage::run_micro_batch(const Batch& batch, double share, StepOutcome& outcome) {
  const CascadeWanted wanted = wanted_outputs(loss_, cascade_.options());
  const CascadeOutput out =
      cascade_.forward({.image = batch.input, .bsdf = batch.bsdf, .mask = batch.mask}, wanted);
  const Losses losses = compute_losses(loss_, out, loss_targets(batch));
  const double total = losses.total.item();
  if (!std::isfinite(total)) {
    std::string culprit = first_non_finite(batch);
    if (culprit.empty()) culprit = first_non_finite(losses.total, cascade_.named_parameters());
    return StepFailure{.what = fmt::format("the loss is {}", total),
                       .layer = std::move(culprit),
                       .scenes = batch.ids,
                       .batch = batch};
  }
  outcome.losses["total"] += share * total;
  for (const LossValue& term : losses.terms)
    outcome.losses[std::string(term.name)] += share * term.value.item();
  backward(affine(losses.total, share));
  return std::nullopt;
}

StepOutcome Stage::step(std::span<const int64_t> sizes, const std::function<Batch()>& next,
                        double rate_factor) {
  StepOutcome outcome;
  outcome.images = std::accumulate(sizes.begin(), sizes.end(), int64_t{0});
  BufferSnapshot buffers(cascade_);
  cascade_.zero_grad();
  std::vector<std::string> scenes;
  Batch batch;
  for (const int64_t size : sizes) {
    batch = next();
    if (batch.size() != size) fail("train", "a micro-batch of {} images instead of {}", batch.size(), size);
    scenes.insert(scenes.end(), batch.ids.begin(), batch.ids.end());
    const double share = static_cast<double>(size) / static_cast<double>(outcome.images);
    outcome.failure = run_micro_batch(batch, share, outcome);
    if (outcome.failure) break;
  }
  if (!outcome.failure) {
    outcome.gradient_norm = gradient_norm(adam_->parameters());
    if (!std::isfinite(outcome.gradient_norm)) {
      outcome.failure = StepFailure{.what = fmt::format("the gradient's norm is {}", outcome.gradient_norm),
                                    .layer = first_non_finite_gradient(adam_->parameters()),
                                    .scenes = scenes,
                                    .batch = batch};
    }
  }
  if (outcome.failure) {
    buffers.restore();
  } else {
    adam_->step(rate_factor);
  }
  cascade_.zero_grad();
  return outcome;
}

}  // namespace opaline
