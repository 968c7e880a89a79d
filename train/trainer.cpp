#include "train/trainer.h"

#include <algorithm>
#include <chrono>
#include <memory>
#include <nlohmann/json.hpp>
#include <numeric>
#include <set>
#include <system_error>
#include <vector>

#include "core/error.h"
#include "core/file.h"
#include "core/kernels/conv_plan.h"
#include "core/numerics.h"
#include "core/ops/sites.h"
#include "core/parallel.h"
#include "data/dataset.h"
#include "data/loader.h"
#include "nn/schedule.h"
#include "train/checkpoint.h"
#include "train/evaluate.h"
#include "train/interrupt.h"
#include "train/log.h"
#include "train/memory_estimate.h"
#include "train/stage.h"

namespace opaline {
namespace {

namespace fs = std::filesystem;
using Clock = std::chrono::steady_clock;

constexpr int64_t kSmallestBatch = 8;

std::shared_ptr<const Dataset> open(const std::string& path) {
  if (path.empty()) {
    fail_usage("train",
               "data.path is not set: name the data set's folder, such as with --set data.path=FOLDER");
  }
  return open_dataset(path);
}

/// Images of each micro-batch of an epoch. Throws Error where there are too few scenes.
std::vector<int64_t> micro_batch_sizes(const Dataset& dataset, const RunConfig& config) {
  const std::string where = dataset.facts().root.string();
  int64_t samples = dataset.size(Split::kTrain);
  if (samples == 0) fail(where, "has no training scenes");
  if (config.data.max_scenes > 0) samples = std::min(samples, config.data.max_scenes);
  const int64_t micro = config.train.micro_batch;
  std::vector<int64_t> sizes = batch_sizes(samples, micro, std::min(kSmallestBatch, micro));
  if (std::find(sizes.begin(), sizes.end(), 1) != sizes.end()) {
    fail(where, "{} training scenes leave a micro-batch of one image, which has no batch statistics",
         samples);
  }
  return sizes;
}

/// Where a run is, told to what it does: the loop over stages, epochs and steps.
class Trainer {
 public:
  Trainer(const RunConfig& config, const TrainerOptions& options)
      : config_(config),
        options_(options),
        dataset_(options.dataset ? options.dataset : open(config.data.path)),
        sizes_(micro_batch_sizes(*dataset_, config)),
        lock_(options.run),
        progress_(options.progress),
        plan_(std::make_shared<kernels::ConvPlan>(config.train.numerics)),
        numerics_(plan_) {
    if (config_.train.threads > 0) set_num_threads(static_cast<int>(config_.train.threads));
    state_.config = config_.text;
    state_.data = dataset_->facts().fingerprint;
  }

  TrainResult start();
  TrainResult resume();

 private:
  void compare_with(const TrainingState& before);
  TrainResult run();
  void open_stage(const Cascade* earlier);
  bool run_stage();
  bool run_epoch(Loader& loader);
  void do_step(Loader& loader, std::span<const int64_t> sizes);
  void count_replaced(const Batch& batch);
  [[noreturn]] void stop_on(const StepFailure& failure);
  void end_epoch();
  void checkpoint();
  void load_plan();
  bool interrupted();
  void begin_session(std::string_view what);
  void say_memory();
  double rate_factor() const;
  const StageConfig& stage_config() const { return config_.stages[static_cast<size_t>(state_.stage - 1)]; }
  int64_t micro_batches_per_step() const { return config_.train.batch / config_.train.micro_batch; }
  int64_t steps_per_epoch() const {
    const auto batches = static_cast<int64_t>(sizes_.size());
    return (batches + micro_batches_per_step() - 1) / micro_batches_per_step();
  }
  int64_t total_steps() const {
    return steps_per_epoch() * (config_.stages[0].epochs + config_.stages[1].epochs);
  }

  RunConfig config_;
  TrainerOptions options_;
  // The scenes are looked at before the folder is made, so that a mistake leaves nothing behind.
  std::shared_ptr<const Dataset> dataset_;
  std::vector<int64_t> sizes_;  // of an epoch's micro-batches
  RunLock lock_;
  Progress progress_;
  std::shared_ptr<kernels::ConvPlan> plan_;
  NumericsGuard numerics_;
  InterruptGuard signals_;
  TrainingState state_;
  std::unique_ptr<Stage> stage_;
  std::unique_ptr<MetricsLog> log_;
  std::set<std::string> damaged_;  // scenes named in this session
  Clock::time_point epoch_begin_ = Clock::now();
  int signal_ = 0;
};

void Trainer::say_memory() {
  if (options_.progress.quiet) return;
  const DatasetFacts& facts = dataset_->facts();
  const bool known = facts.width > 0 && facts.height > 0;
  const int64_t side = config_.model.image_size;
  progress_.note(describe(
      known ? estimate_memory(config_, facts.width, facts.height) : estimate_memory(config_, side, side),
      available_memory()));
}

void Trainer::begin_session(std::string_view what) {
  say_memory();
  append_event(options_.run.sessions(), {{"event", what}, {"step", state_.step}, {"threads", num_threads()}});
}

TrainResult Trainer::start() {
  write_file_atomically(options_.run.config(), std::string_view(config_.text));
  log_ = std::make_unique<MetricsLog>(options_.run.metrics());
  begin_session("start");
  log_->append({{"event", "run"},
                {"seed", config_.train.seed},
                {"data", state_.data},
                {"train_scenes", std::accumulate(sizes_.begin(), sizes_.end(), int64_t{0})},
                {"steps_per_epoch", steps_per_epoch()}});
  open_stage(nullptr);
  return run();
}

void Trainer::compare_with(const TrainingState& before) {
  std::vector<std::string> differences = config_differences(before.config, config_.text);
  if (before.data != state_.data) {
    differences.push_back(
        fmt::format("data set: {} -> {} ({})", before.data, state_.data, dataset_->facts().root.string()));
  }
  if (differences.empty()) return;
  const std::string list = fmt::format("{}", fmt::join(differences, "\n  "));
  if (!options_.force) {
    fail_usage("resume",
               "not what the checkpoint of step {} was made with:\n  {}\nUse --force to go on all the same",
               before.step, list);
  }
  progress_.note(fmt::format("going on with a change (--force):\n  {}", list));
}

TrainResult Trainer::resume() {
  const Warn warn = [&](std::string_view line) { progress_.note(fmt::format("warning: {}", line)); };
  const Checkpoint loaded = options_.from ? load_checkpoint(*options_.from)
                                          : load_newest_checkpoint(options_.run.checkpoints(), warn);
  compare_with(loaded.state);
  const TrainingState mine = state_;
  state_ = loaded.state;
  state_.config = mine.config;
  state_.data = mine.data;
  stage_ = std::make_unique<Stage>(config_, state_.stage);
  restore_networks(loaded, stage_->cascade());
  stage_->adam().load_state_dict(loaded.optimizer, (loaded.folder / "optimizer.safetensors").string());
  write_file_atomically(options_.run.config(), std::string_view(config_.text));
  load_plan();
  log_ = std::make_unique<MetricsLog>(options_.run.metrics(), state_.log_lines);
  begin_session("resume");
  progress_.note(fmt::format("resuming after step {} (stage {}, epoch {})", state_.step, state_.stage,
                             state_.epoch + 1));
  return run();
}

TrainResult Trainer::run() {
  progress_.start(state_.step, total_steps());
  bool complete = run_stage();
  if (complete && state_.stage == 1) {
    state_.stage = 2;
    state_.epoch = 0;
    state_.stage_step = 0;
    const std::unique_ptr<Stage> first = std::move(stage_);
    open_stage(&first->cascade());
    complete = run_stage();
  }
  // A signal in the very last step has nothing left to interrupt.
  if (state_.stage == 2 && state_.epoch >= stage_config().epochs) {
    complete = true;
    signal_ = 0;
  }
  progress_.finish();
  if (complete) log_->append({{"event", "end"}, {"step", state_.step}});
  append_event(
      options_.run.sessions(),
      {{"event", complete ? "complete" : "interrupted"}, {"step", state_.step}, {"signal", signal_}});
  return {.step = state_.step, .signal = signal_};
}

/// A stage from its beginning: weights of an earlier one, where there is one, with fresh moments.
void Trainer::open_stage(const Cascade* earlier) {
  stage_ = std::make_unique<Stage>(config_, state_.stage);
  if (earlier != nullptr) stage_->take_over(*earlier);
  int64_t parameters = 0;
  for (const NamedTensor& parameter : stage_->adam().parameters()) parameters += parameter.tensor.numel();
  log_->append({{"event", "stage"},
                {"stage", state_.stage},
                {"epochs", stage_config().epochs},
                {"networks", stage_->cascade().network_names()},
                {"trained_parameters", parameters}});
}

bool Trainer::run_stage() {
  // Both stages share one count of epochs, so that their shuffles differ.
  const int64_t before = state_.stage == 2 ? config_.stages[0].epochs : 0;
  if (state_.epoch >= stage_config().epochs) return true;
  const bool reconstruction = stage_->cascade().has("reconstruction");
  Loader loader(dataset_,
                {.split = Split::kTrain,
                 .batch = config_.train.micro_batch,
                 .min_last = std::min(kSmallestBatch, config_.train.micro_batch),
                 .shuffle = true,
                 .seed = config_.train.seed,
                 .epochs = before + stage_config().epochs,
                 .max_samples = config_.data.max_scenes,
                 .threads = static_cast<int>(config_.data.threads),
                 .prefetch = config_.data.prefetch,
                 .cache_bytes = config_.data.cache_mib << 20,
                 .damaged = config_.data.damaged,
                 .capture = config_.data.capture,
                 .encode = config_.model.encode,
                 .wanted = {.targets = true,
                            .reconstruction = reconstruction,
                            .support = stage_->cascade().options().support()}},
                {.epoch = before + state_.epoch, .batch = state_.batch});
  while (state_.epoch < stage_config().epochs) {
    if (!run_epoch(loader)) return false;
  }
  return true;
}

/// The rest of the epoch that the state is in; false where a signal ended it.
bool Trainer::run_epoch(Loader& loader) {
  const std::span<const int64_t> sizes = sizes_;
  epoch_begin_ = Clock::now();
  for (bool last = false; !last;) {
    const auto begin = static_cast<size_t>(state_.batch);
    const size_t count = std::min(static_cast<size_t>(micro_batches_per_step()), sizes.size() - begin);
    do_step(loader, sizes.subspan(begin, count));
    last = begin + count == sizes.size();
    if (last) end_epoch();
    const int64_t every = config_.train.checkpoint_every;
    const bool scheduled = last || (every > 0 && state_.step % every == 0);
    if (scheduled) {
      log_->append({{"event", "checkpoint"}, {"step", state_.step}});
      checkpoint();
    }
    if (interrupted()) {
      if (!scheduled) checkpoint();
      return false;
    }
  }
  return true;
}

double Trainer::rate_factor() const {
  const int64_t epochs = stage_config().epochs;
  switch (config_.train.schedule) {
    case Schedule::kStep:
      return linear_decay_by_step(state_.stage_step, epochs * steps_per_epoch());
    case Schedule::kEpoch:
      return linear_decay_by_epoch(state_.epoch, (epochs + 1) / 2, epochs / 2);
    case Schedule::kConstant:
      return 1.0;
  }
  return 1.0;
}

void Trainer::do_step(Loader& loader, std::span<const int64_t> sizes) {
  const double factor = rate_factor();
  const auto next = [&]() -> Batch {
    std::optional<Batch> batch = loader.next();
    if (!batch) fail("train", "the loader ended inside epoch {}", state_.epoch);
    count_replaced(*batch);
    return std::move(*batch);
  };
  const StepOutcome outcome = stage_->step(sizes, next, factor);
  if (outcome.failure) stop_on(*outcome.failure);

  state_.batch += static_cast<int64_t>(sizes.size());
  ++state_.step;
  ++state_.stage_step;
  const auto images = static_cast<double>(outcome.images);
  state_.epoch_sums["images"] += images;
  for (const auto& [name, value] : outcome.losses) state_.epoch_sums[name] += images * value;

  progress_.advance(outcome.images,
                    fmt::format("stage {} epoch {}/{} loss {:.4g}", state_.stage, state_.epoch + 1,
                                stage_config().epochs, outcome.losses.at("total")));
  if (state_.stage_step == 1 || state_.step % config_.train.log_every == 0) {
    log_->append({{"event", "step"},
                  {"stage", state_.stage},
                  {"epoch", state_.epoch},
                  {"step", state_.step},
                  {"images", outcome.images},
                  {"learning_rate", stage_config().learning_rate * factor},
                  {"gradient_norm", outcome.gradient_norm},
                  {"losses", outcome.losses},
                  {"wall", {{"images_per_second", progress_.rate()}}}});
  }
}

/// Names each damaged scene once a session. The count is of the epoch, so that a resumed run has the same.
void Trainer::count_replaced(const Batch& batch) {
  for (const ReplacedScene& scene : batch.replaced) {
    state_.epoch_sums["replaced"] += 1.0;
    if (!damaged_.insert(scene.id).second) continue;
    progress_.note(fmt::format("warning: scene {} is replaced by another: {}", scene.id, scene.what));
    append_event(options_.run.sessions(), {{"event", "damaged"}, {"scene", scene.id}, {"what", scene.what}});
  }
}

void Trainer::stop_on(const StepFailure& failure) {
  state_.log_lines = log_->lines();
  const fs::path folder = save_checkpoint(options_.run.failures(), state_, stage_->cascade(), stage_->adam());
  TensorMap batch;
  const auto keep = [&](const std::string& name, const Tensor& tensor) {
    if (tensor.defined()) batch[name] = tensor.sites() ? to_dense(tensor) : tensor;
  };
  keep("input", failure.batch.input);
  keep("normal", failure.batch.normal);
  keep("depth", failure.batch.depth);
  keep("mask", failure.batch.mask);
  keep("illumination", failure.batch.illumination);
  keep("sss", failure.batch.sss);
  keep("bsdf", failure.batch.bsdf);
  keep("polarised", failure.batch.polarised);
  save_safetensors(folder / "batch.safetensors", batch, {{"layout", "N x H x W x C"}});
  const nlohmann::ordered_json found = {{"what", failure.what},
                                        {"layer", failure.layer},
                                        {"scenes", failure.scenes},
                                        {"step", state_.step + 1}};
  write_file_atomically(folder / "failure.json", std::string_view(found.dump(2)));
  append_event(options_.run.sessions(), {{"event", "failed"}, {"step", state_.step}, {"what", failure.what}});
  fail("train",
       "stage {} step {}: {}; first in {}; scenes of the batch: {}.\nNothing was changed by this step; its "
       "state "
       "and batch are in {} (opaline resume {} --from {} replays it)",
       state_.stage, state_.step + 1, failure.what, failure.layer.empty() ? "(not found)" : failure.layer,
       fmt::join(failure.scenes, ", "), folder.string(), options_.run.root.string(), folder.string());
}

void Trainer::end_epoch() {
  const double epoch_seconds = std::chrono::duration<double>(Clock::now() - epoch_begin_).count();
  const double images = state_.epoch_sums.at("images");
  nlohmann::ordered_json losses;
  for (const auto& [name, sum] : state_.epoch_sums) {
    if (name != "images" && name != "replaced") losses[name] = sum / images;
  }
  nlohmann::ordered_json event = {{"event", "epoch"},
                                  {"stage", state_.stage},
                                  {"epoch", state_.epoch},
                                  {"step", state_.step},
                                  {"images", static_cast<int64_t>(images)},
                                  {"losses", losses}};
  if (const auto replaced = state_.epoch_sums.find("replaced"); replaced != state_.epoch_sums.end()) {
    event["replaced"] = static_cast<int64_t>(replaced->second);
  }
  event["wall"] = {{"seconds", epoch_seconds}, {"images_per_second", progress_.rate()}};
  log_->append(std::move(event));
  std::string line = fmt::format("stage {} epoch {}/{}: loss {:.4g}", state_.stage, state_.epoch + 1,
                                 stage_config().epochs, losses.at("total").get<double>());
  if (config_.train.eval_scenes > 0 && dataset_->size(Split::kTest) > 0) {
    const auto results = evaluate(stage_->cascade(), dataset_, config_.model.encode, nullptr,
                                  {.columns = config_.train.eval_columns,
                                   .max_scenes = config_.train.eval_scenes,
                                   .threads = static_cast<int>(config_.data.threads),
                                   .damaged = config_.data.damaged});
    stage_->set_training();
    const EvaluationSummary summary = summarize(results);
    nlohmann::ordered_json measured = {{"event", "eval"},
                                       {"stage", state_.stage},
                                       {"epoch", state_.epoch},
                                       {"step", state_.step},
                                       {"n", summary.n}};
    measured.update(to_json(summary.cascade));
    log_->append(std::move(measured));
    if (const auto& angle = summary.cascade[static_cast<size_t>(Metric::kAngularDegrees)]) {
      line += fmt::format(", test angle {:.2f} degrees", *angle);
    }
  }
  progress_.note(line);
  ++state_.epoch;
  state_.batch = 0;
  state_.epoch_sums.clear();
}

/// A resumed run makes the choices that it made, so that its numbers are those of one that never stopped.
/// With other numerics (--force) it makes new ones.
void Trainer::load_plan() {
  const fs::path path = options_.run.convolutions();
  if (!fs::exists(path)) return;
  const std::string text = read_text(path.string());
  if (kernels::planned_numerics(text, path.string()) == plan_->numerics()) plan_->load(text, path.string());
}

void Trainer::checkpoint() {
  write_file_atomically(options_.run.convolutions(), std::string_view(plan_->to_json()));
  state_.log_lines = log_->lines();
  save_checkpoint(options_.run.checkpoints(), state_, stage_->cascade(), stage_->adam());
  prune_checkpoints(options_.run.checkpoints(), config_.train.keep);
}

bool Trainer::interrupted() {
  signal_ = options_.interrupted ? options_.interrupted(state_.step) : signals_.signal();
  return signal_ != 0;
}

}  // namespace

TrainResult start_training(const RunConfig& config, const TrainerOptions& options) {
  if (!list_checkpoints(options.run.checkpoints()).empty()) {
    fail_usage(options.run.root.string(),
               "already holds a run with checkpoints: opaline resume {} goes on with it; --run chooses "
               "another folder",
               options.run.root.string());
  }
  return Trainer(config, options).start();
}

TrainResult resume_training(const RunConfig& config, const TrainerOptions& options) {
  return Trainer(config, options).resume();
}

}  // namespace opaline
