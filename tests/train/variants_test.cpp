// What a config can choose, each through the trainer for a few steps: variants, inputs, losses, frozen
// networks.
#include <catch2/catch.hpp>
#include <cmath>
#include <map>
#include <nlohmann/json.hpp>

#include "core/file.h"
#include "core/safetensors.h"
#include "tests/train/synthetic.h"
#include "train/checkpoint.h"
#include "train/log.h"
#include "train/stage.h"
#include "train/trainer.h"

namespace opaline {
namespace {

namespace fs = std::filesystem;
using test::SyntheticDataset;
using test::TemporaryFolder;

// 12 scenes in batches of 4: three steps a stage.
RunConfig config_of(std::vector<std::string> overrides) {
  return parse_run_config(
      "[model]\nimage_size = 32\nwidth = 4\n[train]\nbatch = 4\nmicro_batch = 4\nlog_every = 1\neval_scenes "
      "= 2\n"
      "keep = 9\n[stage1]\nepochs = 1\n[stage2]\nepochs = 1\n",
      "small.toml", overrides);
}

/// Trains both stages; the checkpoints are of steps 3 and 6.
std::vector<nlohmann::json> train(const fs::path& run, const RunConfig& config,
                                  const test::SyntheticOptions& scenes = {.train = 12, .test = 2}) {
  TrainerOptions options{.run = {run}, .dataset = std::make_shared<SyntheticDataset>(scenes)};
  options.progress.quiet = true;
  CHECK(start_training(config, options).step == 6);
  return read_events(run / "metrics.jsonl");
}

/// Every loss and gradient norm of the log, all of them finite.
std::map<std::string, std::vector<double>> losses_of(const std::vector<nlohmann::json>& events) {
  std::map<std::string, std::vector<double>> losses;
  for (const nlohmann::json& event : events) {
    if (event.at("event") != "step") continue;
    REQUIRE(event.at("gradient_norm").is_number());  // JSON has no NaN: it would be null
    for (const auto& [name, value] : event.at("losses").items()) {
      REQUIRE(value.is_number());
      losses[name].push_back(value.get<double>());
    }
  }
  return losses;
}

Shape shape_in(const fs::path& file, const std::string& tensor) {
  return load_safetensors(file).tensors.at(tensor).shape();
}

TEST_CASE("both variants train, with the sizes that they are defined by") {
  struct Sizes {
    std::string variant;
    int64_t input, illumination, sss;
  };
  const Sizes sizes = GENERATE(Sizes{"paper", 19, 28, 7}, Sizes{"release", 21, 27, 8});
  const bool reconstruction = GENERATE(true, false);
  const TemporaryFolder folder("variant");
  const auto losses = losses_of(train(
      folder.path(), config_of({"model.variant=" + sizes.variant, std::string("model.reconstruction=") +
                                                                      (reconstruction ? "true" : "false")})));
  const fs::path last = folder.path() / "checkpoints/step-6";
  CHECK(shape_in(last / "normal.safetensors", "inc.double_conv.0.weight") == Shape{4, sizes.input, 3, 3});
  CHECK(load_safetensors(last / "illumination_decoder.safetensors").tensors.at("model.0.weight").size(0) ==
        sizes.illumination);
  CHECK(fs::exists(last / "reconstruction.safetensors") == reconstruction);
  CHECK(losses.contains("reconstruction") == reconstruction);
  CHECK(losses.at("normal").size() == 6);
  CHECK(losses.at("sss").size() == 3);  // the second stage alone
  if (reconstruction) {
    CHECK(shape_in(last / "reconstruction.safetensors", "inc.double_conv.0.weight") ==
          Shape{4, 12 + sizes.sss, 3, 3});
  }
}

TEST_CASE("every kind of input can be chosen, alone and together") {
  const auto [inputs, channels] = GENERATE(table<std::string, int64_t>(
      {{"['intensity']", 3},
       {"['pol4']", 12},
       {"['maxmin']", 6},
       {"['dop_aop']", 6},
       {"['encoded_aop']", 6},
       {"['stokes']", 9},
       {"['intensity', 'mask']", 4},
       {"['background', 'pol4']", 15},
       {"['intensity', 'pol4', 'maxmin', 'dop_aop', 'encoded_aop', 'stokes', 'mask', 'background']", 46}}));
  const TemporaryFolder folder("inputs");
  const auto losses = losses_of(train(folder.path(), config_of({"model.inputs=" + inputs})));
  const fs::path last = folder.path() / "checkpoints/step-6";
  INFO(inputs);
  CHECK(shape_in(last / "depth.safetensors", "inc.double_conv.0.weight").at(1) == channels);
  CHECK(shape_in(last / "sss.safetensors", "feature_encoder.model.1.weight").at(1) == 5 + channels);
  CHECK(losses.at("total").size() == 6);
}

TEST_CASE("each loss can be L1 or L2, and that is what the log then has") {
  // The first step of a stage is taken with the same weights whatever the loss is: for |d| <= D, mean d^2
  // lies between (mean |d|)^2 and D mean |d|, and is not mean |d|.
  const std::string name = GENERATE("normal", "depth", "illumination", "sss", "reconstruction");
  std::map<std::string, double> first;
  for (const std::string kind : {"l1", "l2"}) {
    const TemporaryFolder folder("losses-" + kind);
    const auto losses = losses_of(train(
        folder.path(), config_of({"stage1.epochs=0", "stage2.epochs=2", "loss." + name + ".kind=" + kind})));
    first[kind] = losses.at(name).front();
  }
  INFO(name << ": l1 " << first["l1"] << ", l2 " << first["l2"]);
  CHECK(first["l2"] >= first["l1"] * first["l1"] * (1.0 - 1e-6));
  CHECK(std::abs(first["l2"] - first["l1"]) > 1e-3 * first["l1"]);
}

TEST_CASE("a frozen network keeps its weights and its running statistics, bit by bit") {
  SECTION("in stage 2, those of stage 1") {
    const std::string name = GENERATE("normal", "depth", "illumination");
    const TemporaryFolder folder("frozen");
    train(folder.path(), config_of({"stage2.freeze=['" + name + "']"}));
    for (const char* const network : {"normal", "depth", "illumination"}) {
      INFO(network);
      const std::string file = std::string(network) + ".safetensors";
      const bool same = read_text(folder.path() / "checkpoints/step-3" / file) ==
                        read_text(folder.path() / "checkpoints/step-6" / file);
      CHECK(same == (network == name));
    }
  }
  SECTION("those drawn at the start") {
    const std::string name = GENERATE("depth", "illumination_decoder", "sss", "reconstruction");
    const TemporaryFolder folder("frozen");
    const RunConfig config = config_of({"stage1.freeze=['depth']", "stage2.freeze=['" + name + "']"});
    train(folder.path(), config);
    Stage fresh(config, 2);
    for (const std::string& network : fresh.cascade().network_names()) {
      INFO(network);
      const TensorMap after =
          load_safetensors(folder.path() / "checkpoints/step-6" / (network + ".safetensors")).tensors;
      bool same = true;
      for (const auto& [key, tensor] : fresh.cascade().network(network).state_dict()) {
        const Tensor& now = after.at(key);
        same = same && std::equal(tensor.bytes(), tensor.bytes() + tensor.byte_size(), now.bytes());
      }
      CHECK(same == (network == name));
    }
  }
}

TEST_CASE("an empty mask and an object of one pixel train without harm") {
  const TemporaryFolder folder("empty");
  const auto events =
      train(folder.path(), config_of({}), {.train = 12, .test = 2, .empty = 3, .one_pixel = 7});
  const auto losses = losses_of(events);
  CHECK(losses.at("total").size() == 6);
  const Checkpoint last = load_checkpoint(folder.path() / "checkpoints/step-6");
  Stage stage(config_of({}), 2);
  restore_networks(last, stage.cascade());  // refuses weights that are not finite
}

}  // namespace
}  // namespace opaline
