// Configs: defaults, round trip, and errors that say where and what was meant.
#include "train/config.h"

#include <catch2/catch.hpp>

#include "core/error.h"

namespace opaline {
namespace {

using Catch::Matchers::Contains;

std::string error_of(std::string_view text, std::vector<std::string> overrides = {}) {
  try {
    parse_run_config(text, "test.toml", overrides);
  } catch (const UsageError& error) {
    return error.what();
  }
  return "";
}

TEST_CASE("an empty config is the paper's recipe") {
  const RunConfig config = parse_run_config("", "test.toml");
  CHECK(config.model.variant == Variant::kPaper);
  CHECK(input_channels(config.model.encode) == 19);
  CHECK(config.model.width == 64);
  CHECK(config.model.image_size == 256);
  CHECK(config.train.schedule == Schedule::kStep);
  CHECK(config.train.beta1 == 0.5);
  CHECK(config.stages[0].epochs == 20);
  CHECK(config.stages[1].learning_rate == 2e-4);
  CHECK(config.loss.normal.weight == 100.0);
  CHECK(config.loss.illumination.weight == 0.1);
  CHECK(config.loss.illumination.kind == LossKind::kL2);
  CHECK(config.warnings.empty());
}

TEST_CASE("the release variant brings its inputs and its schedule") {
  const RunConfig config = parse_run_config("[model]\nvariant = 'release'\n", "test.toml");
  CHECK(input_channels(config.model.encode) == 21);
  CHECK(config.model.encode.quantise);
  CHECK(config.train.schedule == Schedule::kEpoch);
  CHECK(cascade_options(config, 2).network.input_channels == 21);
}

TEST_CASE("the resolved config reads back as itself") {
  const RunConfig config = parse_run_config(
      "[model]\nwidth = 16\nimage_size = 64\ninputs = ['pol4', 'mask']\n[train]\nbatch = 32\nmicro_batch = "
      "16\n"
      "[stage2]\nfreeze = ['depth']\nlearning_rate = 1e-4\n[loss]\nnormal = { weight = 10, kind = 'cosine' "
      "}\n",
      "test.toml", std::vector<std::string>{"train.seed=7", "data.path=somewhere/else"});
  CHECK(config.train.seed == 7);
  CHECK(config.data.path == "somewhere/else");
  const RunConfig again = parse_run_config(config.text, "resolved.toml");
  CHECK(again.text == config.text);
  CHECK(again.loss.normal.kind == LossKind::kCosine);
  CHECK(again.loss.normal.weight == 10.0);
  CHECK(again.stages[1].freeze == std::vector<std::string>{"depth"});
  CHECK(again.stages[1].learning_rate == 1e-4);
  CHECK(input_channels(again.model.encode) == 13);
  CHECK(config_differences(config.text, again.text).empty());
}

TEST_CASE("the table of rendering is read, resolved, and free to change") {
  const RunConfig config = parse_run_config("[render]\ntrain = 8\n[model]\nwidth = 8\n", "test.toml");
  CHECK_THAT(config.text, Contains("[render]") && Contains("train = 8"));
  CHECK_THAT(config.text, Contains("photons = "));  // not given: its default is resolved like any other
  CHECK(parse_run_config(config.text, "again.toml").text == config.text);
  CHECK(config_differences(config.text, parse_run_config("[model]\nwidth = 8\n", "test.toml").text).empty());
  CHECK_THAT(error_of("render = 3\n"), Contains("must be a table"));
  CHECK_THAT(error_of("[rendre]\ntrain = 8\n"), Contains("rendre") && Contains("did you mean 'render'?"));
}

TEST_CASE("the configs of the tree can be read") {
  const std::filesystem::path configs = std::filesystem::path(OPALINE_SOURCE_DIR) / "configs";
  for (const char* const name : {"quick", "small", "paper", "release"}) {
    INFO(name);
    const RunConfig config = load_run_config(configs / (std::string(name) + ".toml"));
    CHECK(config.warnings.empty());
    CHECK(config.train.micro_batch >= 16);
    const bool full = config.model.image_size == 256 && config.model.width == 64;
    CHECK(full == (name == std::string("paper") || name == std::string("release")));
    CHECK((config.model.variant == Variant::kRelease) == (name == std::string("release")));
  }
}

TEST_CASE("an array over several lines is compared element by element") {
  std::string names;
  for (int i = 0; i < 8; ++i) names += "'illumination_decoder', 'reconstruction', ";
  const RunConfig a = parse_run_config("[stage2]\nfreeze = [" + names + "'depth']\n", "a");
  const RunConfig b = parse_run_config("[stage2]\nfreeze = [" + names + "'normal']\n", "b");
  REQUIRE_THAT(a.text, Contains("freeze = [\n"));
  const auto lines = config_differences(a.text, b.text);
  REQUIRE(lines.size() == 1);
  CHECK_THAT(lines[0], Contains("stage2.freeze") && Contains("'depth'") && Contains("'normal'"));
}

TEST_CASE("all errors come at once, each with its line and what may have been meant") {
  const std::string error = error_of(
      "[model]\n"
      "image_size = 72\n"
      "widht = 16\n"
      "inputs = ['pol4', 'maks']\n"
      "[train]\n"
      "batch = 'many'\n"
      "micro_batch = 1\n"
      "[stage1]\n"
      "freeze = ['norml']\n");
  INFO(error);
  CHECK_THAT(error, Contains("test.toml"));
  CHECK_THAT(error, Contains("72") && Contains("16"));
  CHECK_THAT(error, Contains("widht") && Contains("width"));
  CHECK_THAT(error, Contains("maks"));
  CHECK_THAT(error, Contains("batch"));
  CHECK_THAT(error, Contains("batch statistics"));
  CHECK_THAT(error, Contains("norml") && Contains("did you mean \"normal\"?"));
  CHECK_THAT(error, Contains("3") && Contains("6"));  // lines
}

TEST_CASE("values that contradict each other are errors") {
  CHECK_THAT(error_of("[train]\nbatch = 20\nmicro_batch = 16\n"), Contains("not a multiple"));
  CHECK_THAT(error_of("[model]\nwidth = 18\n"), Contains("multiple of 4"));
  CHECK_THAT(error_of("[loss]\ndepth = { kind = 'cosine' }\n"), Contains("cosine"));
  CHECK_THAT(error_of("[loss]\nnormal = { weight = -1 }\n"), Contains("weight"));
  CHECK_THAT(error_of("", {"train.bach=3"}), Contains("bach") && Contains("batch"));
}

TEST_CASE("exposure, sensor and damage policy come from [data], off by default") {
  const RunConfig plain = parse_run_config("", "test.toml");
  CHECK(plain.data.capture.off());
  CHECK(plain.data.damaged == DamagePolicy::kFail);
  CHECK_THAT(plain.text,
             Contains("sensor = false") && Contains("sensor_angle = 1.0") && Contains("exposure"));
  const RunConfig config = parse_run_config(
      "[data]\nexposure = [0.5, 2]\nsensor = true\nsensor_noise = [1e-4, 2e-4, 3e-4]\nsensor_angle = 2\n"
      "sensor_mosaic = false\ndamaged = 'skip'\n",
      "test.toml");
  CHECK(config.data.capture.exposure == std::array{0.5, 2.0});
  CHECK(config.data.capture.sensor.on);
  CHECK(config.data.capture.sensor.noise == std::array{1e-4, 2e-4, 3e-4});
  CHECK(config.data.capture.sensor.angle == 2.0);
  CHECK_FALSE(config.data.capture.sensor.mosaic);
  CHECK(config.data.damaged == DamagePolicy::kSkip);
  CHECK(config_differences(plain.text, config.text).size() == 6);
  CHECK_THAT(error_of("[data]\nexposure = [2, 1]\n"), Contains("[low, high]"));
  CHECK_THAT(error_of("[data]\nexposure = [1]\n"), Contains("exposure"));
  CHECK_THAT(error_of("[data]\nexposure = [0, 1]\n"), Contains("exposure"));
  CHECK_THAT(error_of("[data]\nsensor_gian = 0.1\n"), Contains("sensor_gain"));
  CHECK_THAT(error_of("[data]\nsensor_extinction = 1.1\n"), Contains("sensor_extinction"));
  CHECK_THAT(error_of("[data]\ndamaged = 'ignore'\n"), Contains("skip"));
}

TEST_CASE("what the networks skip is a model's own") {
  const RunConfig plain = parse_run_config("", "test.toml");
  CHECK(cascade_options(plain, 2).skip == Skip::kSupport);
  const RunConfig config = parse_run_config("[model]\nskip = 'none'\nskip_dilation = 1\n", "test.toml");
  CHECK(cascade_options(config, 2).skip == Skip::kNone);
  CHECK(cascade_options(config, 2).dilation == 1);
  CHECK(config_differences(plain.text, config.text).size() == 2);
  CHECK_THAT(error_of("[model]\nskip = 'mask'\n"), Contains("support"));
}

TEST_CASE("columns of the evaluation are chosen by name") {
  CHECK(parse_run_config("", "test.toml").train.eval_columns.sss);
  const RunConfig config = parse_run_config("[train]\neval_columns = ['normal']\n", "test.toml");
  CHECK(config.train.eval_columns.normal);
  CHECK_FALSE(config.train.eval_columns.depth);
  CHECK_FALSE(config.train.eval_columns.sss);
  CHECK_THAT(error_of("[train]\neval_columns = ['g']\n"), Contains("eval_columns") && Contains("sss"));
}

TEST_CASE("the illumination's images must remain images that networks take") {
  const RunConfig config =
      parse_run_config("[model]\nimage_size = 64\nillumination_downscale = 2\n", "test.toml");
  CHECK(cascade_options(config, 2).illumination_downscale == 2);
  for (const char* value : {"3", "4", "0"}) {
    CHECK_THAT(error_of(fmt::format("[model]\nimage_size = 64\nillumination_downscale = {}\n", value)),
               Contains("illumination_downscale"));
  }
}

TEST_CASE("a small micro-batch is a warning") {
  const RunConfig config = parse_run_config("[train]\nbatch = 8\nmicro_batch = 4\n", "test.toml");
  REQUIRE(config.warnings.size() == 1);
  CHECK_THAT(config.warnings[0], Contains("micro_batch = 4"));
}

TEST_CASE("differences that decide the numbers are told from those that do not") {
  const std::string a = parse_run_config("", "a").text;
  const std::string b =
      parse_run_config(
          "[data]\nthreads = 2\npath = 'moved'\n[train]\nkeep = 9\nactivation_checkpointing = true\n", "b")
          .text;
  CHECK(config_differences(a, b).empty());
  const std::string c = parse_run_config("[train]\nseed = 3\n[loss]\nsss = { weight = 2 }\n", "c").text;
  const auto lines = config_differences(a, c);
  REQUIRE(lines.size() == 2);
  CHECK_THAT(lines[0], Contains("weight") && Contains("2"));
  CHECK_THAT(lines[1], Contains("train.seed: 1 -> 3"));
}

}  // namespace
}  // namespace opaline
