// Whole runs on small networks: bitwise resumption, overfitting, and what happens when things go wrong.
#include <catch2/catch.hpp>
#include <csignal>
#include <fstream>
#include <nlohmann/json.hpp>
#include <set>

#include "core/error.h"
#include "core/file.h"
#include "core/memory.h"
#include "core/parallel.h"
#include "nn/schedule.h"
#include "tests/train/synthetic.h"
#include "train/checkpoint.h"
#include "train/interrupt.h"
#include "train/log.h"
#include "train/stage.h"
#include "train/trainer.h"

namespace opaline {
namespace {

namespace fs = std::filesystem;
using Catch::Matchers::Contains;
using test::SyntheticDataset;
using test::TemporaryFolder;

// 20 scenes in micro-batches of 4: three steps an epoch, the last one shorter; six steps a stage.
constexpr std::string_view kSmall = R"(
[model]
image_size = 32
width = 4
[train]
batch = 8
micro_batch = 4
log_every = 1
eval_scenes = 2
keep = 100
[stage1]
epochs = 2
[stage2]
epochs = 2
)";

RunConfig small_config(std::vector<std::string> overrides = {}) {
  return parse_run_config(kSmall, "small.toml", overrides);
}

std::shared_ptr<const Dataset> scenes(test::SyntheticOptions options = {.train = 20, .test = 2}) {
  return std::make_shared<SyntheticDataset>(options);
}

TrainerOptions quiet(const fs::path& folder, std::shared_ptr<const Dataset> dataset = scenes()) {
  TrainerOptions options{.run = {folder}, .dataset = std::move(dataset)};
  options.progress.quiet = true;
  return options;
}

/// Ends a run after a step, as a signal would.
TrainerOptions stopping_after(int64_t step, TrainerOptions options) {
  options.interrupted = [step](int64_t done) { return done == step ? SIGTERM : 0; };
  return options;
}

/// The log without what depends on the clock and the machine.
std::string log_without_wall(const fs::path& run) {
  std::string text;
  for (nlohmann::json event : read_events(run / "metrics.jsonl")) {
    event.erase("wall");
    text += event.dump() + "\n";
  }
  return text;
}

/// All files of a folder by name.
std::map<std::string, std::string> files_of(const fs::path& folder) {
  std::map<std::string, std::string> files;
  for (const auto& entry : fs::directory_iterator(folder)) {
    files[entry.path().filename().string()] = read_text(entry.path());
  }
  return files;
}

/// The same checkpoint and the same log, byte for byte.
void check_same_run(const fs::path& a, const fs::path& b, const std::string& step) {
  const auto left = files_of(a / "checkpoints" / step);
  const auto right = files_of(b / "checkpoints" / step);
  REQUIRE(left.size() == 8);  // six networks, moments, state
  REQUIRE(right.size() == left.size());
  for (const auto& [name, bytes] : left) {
    INFO(name);
    CHECK(right.at(name) == bytes);
  }
  CHECK(log_without_wall(a) == log_without_wall(b));
}

/// The first training scenes, encoded, as one batch.
Batch first_scenes(const RunConfig& config, int64_t count) {
  const SyntheticDataset dataset({.train = count, .test = 0});
  std::vector<Sample> samples;
  for (int64_t i = 0; i < count; ++i) {
    samples.push_back(encode_scene(dataset.load(Split::kTrain, i, {}), config.model.encode));
  }
  return make_batch(samples);
}

TEST_CASE("a run that was stopped and resumed is bitwise the run that was not") {
  const TemporaryFolder folder("resume");
  const fs::path whole = folder.path() / "whole";
  const TrainResult result = start_training(small_config(), quiet(whole));
  CHECK(result.step == 12);
  CHECK(result.signal == 0);

  // In mid-epoch, at an epoch's end, at the stage's end, and in mid-epoch of stage 2.
  for (const int64_t step : {2, 3, 6, 8}) {
    INFO("stopped after step " << step);
    const fs::path run = folder.path() / ("stopped-" + std::to_string(step));
    const TrainResult stopped = start_training(small_config(), stopping_after(step, quiet(run)));
    CHECK(stopped.step == step);
    CHECK(stopped.signal == SIGTERM);
    CHECK(resume_training(small_config(), quiet(run)).step == 12);
    check_same_run(whole, run, "step-12");
  }

  SECTION("also when it is stopped after every step") {
    const fs::path run = folder.path() / "often";
    start_training(small_config(), stopping_after(1, quiet(run)));
    for (int64_t step = 2; step <= 12; ++step) {
      resume_training(small_config(), stopping_after(step, quiet(run)));
    }
    check_same_run(whole, run, "step-12");
  }

  SECTION("also after a crash that left later steps in the log and a damaged checkpoint") {
    const fs::path run = folder.path() / "crashed";
    start_training(small_config(), stopping_after(8, quiet(run)));
    fs::resize_file(run / "checkpoints/step-8/sss.safetensors", 1000);
    std::ofstream(run / "metrics.jsonl", std::ios::app) << R"({"event":"step","step":9)";
    CHECK(resume_training(small_config(), quiet(run)).step == 12);
    check_same_run(whole, run, "step-12");
  }
}

TEST_CASE("a damaged scene ends a run or is named, counted and replaced, as the config says") {
  const auto damaged = [] { return scenes({.train = 20, .test = 2, .damaged = 1}); };
  const TemporaryFolder fails("damaged-fails");
  CHECK_THROWS_WITH(start_training(small_config(), quiet(fails.path(), damaged())),
                    Contains("train-1") && Contains("the file ends early"));

  const RunConfig config = small_config({"data.damaged=skip", "data.threads=2"});
  const TemporaryFolder whole("damaged-whole");
  CHECK(start_training(config, quiet(whole.path(), damaged())).step == 12);
  int64_t epochs = 0;
  for (const nlohmann::json& event : read_events(whole.path() / "metrics.jsonl")) {
    if (event["event"] == "epoch") {
      ++epochs;
      CHECK(event.at("replaced") == 1);
      CHECK(event.at("images") == 20);
      CHECK_FALSE(event.at("losses").contains("replaced"));
    }
    if (event["event"] == "eval") CHECK(event.at("n") == 1);  // of two test scenes
  }
  CHECK(epochs == 4);
  int64_t named = 0;
  for (const nlohmann::json& event : read_events(whole.path() / "sessions.jsonl")) {
    if (event["event"] == "damaged") {
      ++named;
      CHECK(event.at("scene") == "train-1");
    }
  }
  CHECK(named == 1);

  const TemporaryFolder parts("damaged-parts");
  start_training(config, stopping_after(4, quiet(parts.path(), damaged())));
  resume_training(config, quiet(parts.path(), damaged()));
  check_same_run(whole.path(), parts.path(), "step-12");
}

TEST_CASE("a run on sensor images resumes bitwise") {
  const RunConfig config = small_config({"data.sensor=true", "data.exposure=[0.5,2]"});
  const TemporaryFolder whole("sensor-whole");
  const TemporaryFolder parts("sensor-parts");
  start_training(config, quiet(whole.path()));
  start_training(config, stopping_after(5, quiet(parts.path())));
  resume_training(
      small_config({"data.sensor=true", "data.exposure=[0.5,2]", "data.threads=3", "data.cache_mib=0"}),
      quiet(parts.path()));
  const auto left = files_of(whole.path() / "checkpoints/step-12");
  for (const auto& [name, bytes] : files_of(parts.path() / "checkpoints/step-12")) {
    if (name != "state.json") CHECK(left.at(name) == bytes);  // it holds the config
  }
  CHECK(log_without_wall(whole.path()) == log_without_wall(parts.path()));
  const TemporaryFolder clean("sensor-clean");
  start_training(small_config(), quiet(clean.path()));
  CHECK(log_without_wall(whole.path()) != log_without_wall(clean.path()));
}

TEST_CASE("a run that skips what masks leave out resumes bitwise, with any number of threads") {
  // Among the scenes one has no object, and one a single pixel of it.
  const auto data = [] { return scenes({.train = 12, .test = 2, .size = 64, .empty = 3, .one_pixel = 5}); };
  const auto config = [](const std::string& skip, const std::string& threads) {
    return small_config({"model.image_size=64", "model.skip=" + skip, "train.threads=" + threads,
                         "stage1.epochs=1", "stage2.epochs=1"});
  };
  const TemporaryFolder folder("skip");
  const fs::path whole = folder.path() / "whole", parts = folder.path() / "parts";
  const TrainResult result = start_training(config("support", "1"), quiet(whole, data()));
  const std::string last = "step-" + std::to_string(result.step);
  start_training(config("support", "3"), stopping_after(3, quiet(parts, data())));
  resume_training(config("support", "3"), quiet(parts, data()));
  const auto left = files_of(whole / "checkpoints" / last), right = files_of(parts / "checkpoints" / last);
  REQUIRE(left.size() == right.size());
  for (const auto& [name, bytes] : left) {
    INFO(name);
    if (name != "state.json") CHECK(right.at(name) == bytes);  // the state has the config, threads and all
  }
  CHECK(log_without_wall(whole) == log_without_wall(parts));

  start_training(config("none", "1"), quiet(folder.path() / "dense", data()));
  CHECK(log_without_wall(whole) != log_without_wall(folder.path() / "dense"));
  CHECK_THROWS_WITH(resume_training(config("none", "1"), quiet(parts, data())), Contains("model.skip"));
}

TEST_CASE("threads change nothing but the time") {
  const TemporaryFolder folder("threads");
  for (const std::string threads : {"1", "2", "3"}) {
    start_training(small_config({"train.threads=" + threads, "data.threads=" + threads, "stage2.epochs=1"}),
                   quiet(folder.path() / threads));
  }
  set_num_threads(0);
  for (const std::string threads : {"2", "3"}) {
    INFO(threads << " threads");
    const auto one = files_of(folder.path() / "1/checkpoints/step-9");
    const auto more = files_of(folder.path() / threads / "checkpoints/step-9");
    REQUIRE(more.size() == one.size());
    for (const auto& [name, bytes] : one) {
      INFO(name);
      if (name != "state.json") CHECK(more.at(name) == bytes);  // the state has the config, threads and all
    }
    CHECK(log_without_wall(folder.path() / "1") == log_without_wall(folder.path() / threads));
  }
}

TEST_CASE("activation checkpointing changes nothing but time and memory") {
  const TemporaryFolder folder("checkpointing");
  for (const std::string on : {"false", "true"}) {
    start_training(small_config({"train.activation_checkpointing=" + on, "stage2.epochs=1"}),
                   quiet(folder.path() / on));
  }
  const auto kept = files_of(folder.path() / "false/checkpoints/step-9");
  const auto again = files_of(folder.path() / "true/checkpoints/step-9");
  REQUIRE(kept.size() == again.size());
  for (const auto& [name, bytes] : kept) {
    INFO(name);
    if (name != "state.json") CHECK(again.at(name) == bytes);  // the state has the config
  }
  CHECK(log_without_wall(folder.path() / "false") == log_without_wall(folder.path() / "true"));

  const auto peak = [](const std::string& on) {
    const RunConfig config = small_config({"train.activation_checkpointing=" + on});
    const Batch batch = first_scenes(config, 8);
    Stage stage(config, 2);
    const int64_t before = tensor_pool().bytes_in_use();
    tensor_pool().reset_peak();
    stage.step(
        std::vector<int64_t>{8}, [&] { return batch; }, 1.0);
    return static_cast<double>(tensor_pool().peak_bytes() - before);
  };
  CHECK(peak("true") < 0.7 * peak("false"));
}

TEST_CASE("four scenes can be learnt by heart, in either stage") {
  const int number = GENERATE(1, 2);
  const RunConfig config =
      small_config({"model.width=8", "stage1.learning_rate=2e-3", "stage2.learning_rate=2e-3"});
  const Batch batch = first_scenes(config, 4);
  Stage stage(config, number);  // from freshly drawn weights: the start is that of all terms
  std::vector<StepOutcome> steps;
  constexpr int kSteps = 360;
  for (int i = 0; i < kSteps; ++i) {
    // At a constant rate an L1 loss ends in a swing as large as the steps; the recipe's decay takes it away.
    const double factor = linear_decay_by_step(i, kSteps);
    steps.push_back(stage.step(
        std::vector<int64_t>{4}, [&] { return batch; }, factor));
    REQUIRE_FALSE(steps.back().failure);
  }
  for (const auto& [name, first] : steps.front().losses) {
    UNSCOPED_INFO(name << ": " << first << " -> " << steps.back().losses.at(name));
  }
  CHECK(steps.back().losses.at("total") < 0.02 * steps.front().losses.at("total"));
}

TEST_CASE("micro-batches add up to the gradient of the mean") {
  const RunConfig config = small_config();
  const Batch batch = first_scenes(config, 4);
  const auto next = [&] { return batch; };
  const StepOutcome once = Stage(config, 2).step(std::vector<int64_t>{4}, next, 1.0);
  const StepOutcome thrice = Stage(config, 2).step(std::vector<int64_t>{4, 4, 4}, next, 1.0);
  CHECK_FALSE(once.failure);
  CHECK(once.losses.size() == 6);
  CHECK(thrice.images == 12);
  CHECK(thrice.gradient_norm == Approx(once.gradient_norm).epsilon(1e-4));
  CHECK(thrice.losses.at("total") == Approx(once.losses.at("total")).epsilon(1e-5));
}

TEST_CASE("frozen networks and terms without weight stay untouched") {
  const TemporaryFolder folder("freeze");
  const RunConfig config = small_config({"stage1.epochs=1", "stage2.epochs=1", "stage2.freeze=['normal']",
                                         "loss.depth.weight=0", "loss.reconstruction.weight=0"});
  start_training(config, quiet(folder.path()));
  const auto before = files_of(folder.path() / "checkpoints/step-3");
  const auto after = files_of(folder.path() / "checkpoints/step-6");
  CHECK(before.at("normal.safetensors") == after.at("normal.safetensors"));
  CHECK(before.at("illumination.safetensors") != after.at("illumination.safetensors"));
  CHECK_FALSE(after.contains("reconstruction.safetensors"));
  for (const nlohmann::json& event : read_events(folder.path() / "metrics.jsonl")) {
    if (event.at("event") == "step") CHECK_FALSE(event.at("losses").contains("depth"));
  }
  CHECK_THROWS_WITH(Stage(small_config({"stage1.freeze=['normal', 'depth', 'illumination']"}), 1),
                    Contains("nothing is left to train"));
}

TEST_CASE("a changed config or data set is refused with the difference, unless forced") {
  const TemporaryFolder folder("changed");
  start_training(small_config(), stopping_after(2, quiet(folder.path())));
  const RunConfig changed = small_config({"train.seed=9", "data.threads=2"});
  CHECK_THROWS_WITH(resume_training(changed, quiet(folder.path())),
                    Contains("train.seed: 1 -> 9") && !Contains("threads") && Contains("--force"));
  const auto other = scenes({.train = 20, .test = 2, .fingerprint = "synthetic-2"});
  CHECK_THROWS_WITH(resume_training(small_config(), quiet(folder.path(), other)),
                    Contains("synthetic-1") && Contains("synthetic-2"));
  TrainerOptions forced = quiet(folder.path(), other);
  forced.force = true;
  CHECK(resume_training(changed, forced).step == 12);
}

TEST_CASE("a run folder is not overwritten, nor shared") {
  const TemporaryFolder folder("folder");
  {
    const RunLock lock({folder.path()});
    CHECK_THROWS_WITH(start_training(small_config(), quiet(folder.path())),
                      Contains(std::to_string(::getpid())) && Contains("is training in this run folder"));
  }
  start_training(small_config({"stage2.epochs=0"}), stopping_after(1, quiet(folder.path())));
  CHECK_THROWS_AS(start_training(small_config(), quiet(folder.path())), UsageError);
}

TEST_CASE("a loss that is not finite stops the run, names layer and scenes, and can be replayed") {
  const TemporaryFolder folder("poison");
  const auto poisoned = scenes({.train = 20, .test = 0, .poisoned = 13});
  std::string message;
  try {
    start_training(small_config(), quiet(folder.path(), poisoned));
  } catch (const Error& error) {
    message = error.what();
  }
  INFO(message);
  CHECK_THAT(message, Contains("the loss is") && Contains("first in the normal of train-13;"));
  const auto failures = list_checkpoints(folder.path() / "failures");
  REQUIRE(failures.size() == 1);
  CHECK(fs::exists(failures[0] / "batch.safetensors"));
  CHECK(fs::exists(failures[0] / "failure.json"));
  // What was saved is sound, and the step fails in the same way from it.
  TrainerOptions replay = quiet(folder.path(), poisoned);
  replay.from = failures[0];
  CHECK_THROWS_WITH(resume_training(small_config(), replay), Contains("train-13"));
}

TEST_CASE("weights that are not finite are named") {
  Stage stage(small_config(), 1);
  Tensor weight = stage.cascade().network("depth").named_parameters().at(4).tensor;
  weight.data<float>()[0] = std::numeric_limits<float>::infinity();
  std::map<std::string, TensorMap> before;
  for (const std::string& name : stage.cascade().network_names()) {
    for (const auto& [key, tensor] : stage.cascade().network(name).state_dict()) {
      before[name][key] = tensor.clone();
    }
  }
  const StepOutcome outcome = stage.step(
      std::vector<int64_t>{4}, [] { return first_scenes(small_config(), 4); }, 1.0);
  for (const auto& [name, state] : before) {
    for (const auto& [key, tensor] : state) {
      const Tensor now = stage.cascade().network(name).state_dict().at(key);
      INFO(name << "." << key);  // running statistics of the failed pass included
      CHECK(std::equal(tensor.bytes(), tensor.bytes() + tensor.byte_size(), now.bytes()));
    }
  }
  REQUIRE(outcome.failure);
  CHECK_THAT(outcome.failure->layer,
             Contains("depth." + stage.cascade().network("depth").named_parameters().at(4).name));
  CHECK(outcome.failure->scenes.size() == 4);
}

TEST_CASE("a scene too few for batch statistics is explained") {
  const TemporaryFolder folder("one");
  CHECK_THROWS_WITH(start_training(small_config(), quiet(folder.path(), scenes({.train = 1, .test = 0}))),
                    Contains("one image"));
  CHECK_THROWS_WITH(start_training(small_config(), quiet(folder.path(), scenes({.train = 0, .test = 0}))),
                    Contains("no training scenes"));
}

TEST_CASE("the first signal is remembered, and the handlers are put back") {
  struct sigaction before {};
  sigaction(SIGTERM, nullptr, &before);
  {
    const InterruptGuard guard;
    CHECK(guard.signal() == 0);
    std::raise(SIGTERM);
    CHECK(guard.signal() == SIGTERM);
  }
  struct sigaction after {};
  sigaction(SIGTERM, nullptr, &after);
  CHECK(before.sa_handler == after.sa_handler);
}

}  // namespace
}  // namespace opaline
