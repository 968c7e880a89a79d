#include "train/config.h"

#include <algorithm>
#include <map>
#include <optional>
#include <set>

#include "core/error.h"
#include "core/file.h"
#include "data/toml_config.h"

namespace opaline {
namespace {

constexpr int64_t kSmallMicroBatch = 8;
constexpr int64_t kMost = 1'000'000'000;
constexpr std::array<std::string_view, 2> kVariants = {"paper", "release"};
constexpr std::array<std::string_view, 3> kSchedules = {"step", "epoch", "constant"};

constexpr std::array<std::string_view, 3> kNumerics = {"strict", "balanced", "fast"};
constexpr std::array<std::string_view, 2> kSkips = {"none", "support"};
constexpr std::array<std::string_view, 2> kDamagePolicies = {"fail", "skip"};

template <size_t N>
std::array<double, N> read_reals(const TomlTable& table, std::string_view key,
                                 const std::array<double, N>& otherwise, const RealRange& range) {
  const std::vector<double> values = table.reals(key, {otherwise.begin(), otherwise.end()}, range, N);
  std::array<double, N> result = otherwise;
  if (values.size() == N) std::copy(values.begin(), values.end(), result.begin());
  return result;
}

CaptureOptions read_capture(const TomlTable& table) {
  CaptureOptions capture;
  capture.exposure = read_reals(table, "exposure", capture.exposure, {.min = 1e-3, .max = 1e3});
  if (capture.exposure[0] > capture.exposure[1]) table.error("exposure", "must be [low, high]");
  SensorOptions& sensor = capture.sensor;
  sensor.on = table.boolean("sensor", sensor.on);
  sensor.noise = read_reals(table, "sensor_noise", sensor.noise, {.min = 0.0, .max = 1.0});
  sensor.gain = table.real("sensor_gain", sensor.gain, {.min = 0.0, .max = 0.5});
  sensor.angle = table.real("sensor_angle", sensor.angle, {.min = 0.0, .max = 45.0});
  sensor.extinction = table.real("sensor_extinction", sensor.extinction, {.min = 0.0, .max = 1.0});
  sensor.white_balance = table.real("sensor_white_balance", sensor.white_balance, {.min = 0.0, .max = 0.5});
  sensor.mosaic = table.boolean("sensor_mosaic", sensor.mosaic);
  sensor.truncate = table.boolean("sensor_truncate", sensor.truncate);
  return capture;
}

DataConfig read_data(const TomlTable& table) {
  const DataConfig d;
  return {.path = table.text("path", d.path),
          .max_scenes = table.integer("max_scenes", d.max_scenes, {.min = 0}),
          .threads = table.integer("threads", d.threads, {.min = 1, .max = 1024}),
          .prefetch = table.integer("prefetch", d.prefetch, {.min = 1, .max = 1024}),
          .cache_mib = table.integer("cache_mib", d.cache_mib, {.min = 0, .max = int64_t{1} << 24}),
          .damaged = table.choice("damaged", "fail", kDamagePolicies) == "skip" ? DamagePolicy::kSkip
                                                                                : DamagePolicy::kFail,
          .capture = read_capture(table)};
}

std::vector<InputKind> read_inputs(const TomlTable& table, const std::vector<InputKind>& otherwise) {
  std::vector<std::string> names;
  for (const InputKind kind : otherwise) names.emplace_back(to_string(kind));
  std::vector<InputKind> kinds;
  for (const std::string& name : table.texts("inputs", names)) {
    try {
      kinds.push_back(parse_input_kind(name));
    } catch (const UsageError& error) {
      table.error("inputs", error.what());
    }
  }
  if (kinds.empty()) table.error("inputs", "names no input");
  if (std::set<InputKind>(kinds.begin(), kinds.end()).size() != kinds.size()) {
    table.error("inputs", "names an input twice");
  }
  return kinds;
}

ModelConfig read_model(const TomlTable& table) {
  ModelConfig model;
  const bool paper = table.choice("variant", "paper", kVariants) == "paper";
  model.variant = paper ? Variant::kPaper : Variant::kRelease;
  model.image_size = table.integer("image_size", model.image_size, {.min = 32, .max = 4096});
  if (model.image_size % 16 != 0) {
    table.error("image_size",
                fmt::format("{} is not divisible by 16, as four halvings need", model.image_size));
  }
  model.width = table.integer("width", model.width, {.min = 4, .max = 1024});
  if (model.width % 4 != 0) table.error("width", fmt::format("{} is not a multiple of 4", model.width));
  model.encode = paper ? EncodeOptions::paper() : EncodeOptions::release();
  model.encode.inputs = read_inputs(table, model.encode.inputs);
  model.reconstruction = table.boolean("reconstruction", true);
  model.skip = parse_skip(table.choice("skip", to_string(model.skip), kSkips)).value_or(model.skip);
  model.skip_dilation = table.integer("skip_dilation", model.skip_dilation, {.min = 0, .max = 256});
  model.illumination_downscale =
      table.integer("illumination_downscale", model.illumination_downscale, {.min = 1, .max = 8});
  const int64_t smaller = model.image_size / model.illumination_downscale;
  if (model.image_size % model.illumination_downscale != 0 || smaller % 16 != 0 || smaller < 32) {
    table.error("illumination_downscale",
                fmt::format("{} of image_size {} leaves no image of a multiple of 16 pixels, at least 32",
                            model.illumination_downscale, model.image_size));
  }
  return model;
}

EvaluateColumns read_columns(const TomlTable& table) {
  const std::vector<std::string> names = table.texts("eval_columns", {});
  for (const std::string& name : names) {
    if (std::ranges::find(kColumnNames, name) != kColumnNames.end()) continue;
    table.error("eval_columns", fmt::format("\"{}\" is none of {}", name, fmt::join(kColumnNames, ", ")));
    return {};
  }
  return parse_columns(names);
}

TrainConfig read_train(const TomlTable& table, Variant variant, std::vector<std::string>& warnings) {
  TrainConfig train;
  train.seed = static_cast<uint64_t>(table.integer("seed", 1, {.min = 0}));
  train.batch = table.integer("batch", train.batch, {.min = 2, .max = kMost});
  train.micro_batch = table.integer("micro_batch", std::min<int64_t>(train.micro_batch, train.batch),
                                    {.min = 1, .max = kMost});
  if (train.micro_batch == 1) {
    table.error("micro_batch",
                "1 image has no batch statistics: every value behind a BatchNorm1d would be its "
                "offset; use at least 2, better 8");
  } else if (train.micro_batch < kSmallMicroBatch) {
    warnings.push_back(
        fmt::format("train.micro_batch = {}: the statistics of fewer than {} images are poor, and "
                    "the illumination and SSS heads suffer from it",
                    train.micro_batch, kSmallMicroBatch));
  }
  if (train.batch % train.micro_batch != 0) {
    table.error("batch",
                fmt::format("{} is not a multiple of micro_batch = {}", train.batch, train.micro_batch));
  }
  train.beta1 = table.real("beta1", train.beta1, {.min = 0.0, .max = 0.999999});
  train.beta2 = table.real("beta2", train.beta2, {.min = 0.0, .max = 0.9999999});
  train.eps = table.real("eps", train.eps, {.min = 1e-30, .max = 1.0});
  train.numerics =
      parse_numerics(table.choice("numerics", to_string(train.numerics), kNumerics)).value_or(train.numerics);
  train.activation_checkpointing = table.boolean("activation_checkpointing", train.activation_checkpointing);
  const std::string schedule =
      table.choice("schedule", variant == Variant::kPaper ? "step" : "epoch", kSchedules);
  train.schedule = schedule == "step"    ? Schedule::kStep
                   : schedule == "epoch" ? Schedule::kEpoch
                                         : Schedule::kConstant;
  train.log_every = table.integer("log_every", train.log_every, {.min = 1});
  train.checkpoint_every = table.integer("checkpoint_every", train.checkpoint_every, {.min = 0});
  train.keep = table.integer("keep", train.keep, {.min = 1});
  train.eval_scenes = table.integer("eval_scenes", train.eval_scenes, {.min = 0});
  train.eval_columns = read_columns(table);
  train.threads = table.integer("threads", train.threads, {.min = 0, .max = 4096});
  return train;
}

StageConfig read_stage(const TomlTable& table) {
  StageConfig stage;
  stage.epochs = table.integer("epochs", stage.epochs, {.min = 0, .max = 1'000'000});
  stage.learning_rate = table.real("learning_rate", stage.learning_rate, {.min = 0.0, .max = 10.0});
  stage.freeze = table.texts("freeze", {});
  const std::vector<std::string> names(kNetworkNames.begin(), kNetworkNames.end());
  for (const std::string& name : stage.freeze) {
    if (std::find(names.begin(), names.end(), name) != names.end()) continue;
    const std::string near = did_you_mean(name, names);
    table.error("freeze", fmt::format("there is no network \"{}\"{}; there are {}", name,
                                      near.empty() ? "" : fmt::format(" (did you mean \"{}\"?)", near),
                                      fmt::join(names, ", ")));
  }
  return stage;
}

LossTerm read_term(const TomlTable& table, const LossTerm& otherwise, bool cosine) {
  constexpr std::array<std::string_view, 3> kinds = {"l1", "l2", "cosine"};
  const std::span<const std::string_view> allowed(kinds.data(), cosine ? 3 : 2);
  LossTerm term;
  term.weight = table.real("weight", otherwise.weight, {.min = 0.0});
  term.kind =
      parse_loss_kind(table.choice("kind", to_string(otherwise.kind), allowed)).value_or(otherwise.kind);
  return term;
}

LossOptions read_loss(const TomlTable& table) {
  const LossOptions d;
  return {.normal = read_term(table.table("normal"), d.normal, true),
          .depth = read_term(table.table("depth"), d.depth, false),
          .illumination = read_term(table.table("illumination"), d.illumination, false),
          .sss = read_term(table.table("sss"), d.sss, false),
          .reconstruction = read_term(table.table("reconstruction"), d.reconstruction, false)};
}

RunConfig read_config(TomlConfig config) {
  RunConfig run;
  const TomlTable root = config.root();
  run.render = read_generate_config(root.table("render"));
  run.data = read_data(root.table("data"));
  run.model = read_model(root.table("model"));
  run.train = read_train(root.table("train"), run.model.variant, run.warnings);
  run.stages[0] = read_stage(root.table("stage1"));
  run.stages[1] = read_stage(root.table("stage2"));
  run.loss = read_loss(root.table("loss"));
  config.finish();
  run.text = config.resolved();
  return run;
}

/// Resolved TOML as "table.key" -> value. It has one key a line; only long arrays go on in indented lines.
std::map<std::string, std::string> flat_keys(std::string_view text) {
  std::map<std::string, std::string> keys;
  std::string table;
  std::string* last = nullptr;
  while (!text.empty()) {
    const size_t end = std::min(text.find('\n'), text.size());
    const std::string_view line = text.substr(0, end);
    text.remove_prefix(std::min(end + 1, text.size()));
    if (line.starts_with('[')) {
      table = std::string(line.substr(1, line.find(']') - 1)) + ".";
      continue;
    }
    const size_t equals = line.find(" = ");
    const bool goes_on = last != nullptr && (line.starts_with(' ') || line.starts_with(']'));
    if (goes_on) {
      last->append(line.substr(std::min(line.find_first_not_of(' '), line.size())));
    } else if (equals != std::string_view::npos) {
      last = &keys[table + std::string(line.substr(0, equals))];
      *last = line.substr(equals + 3);
    }
  }
  return keys;
}

bool decides_numbers(const std::string& key) {
  static const std::set<std::string> free = {"data.path",
                                             "data.threads",
                                             "data.prefetch",
                                             "data.cache_mib",
                                             "train.threads",
                                             "train.keep",
                                             "train.activation_checkpointing"};
  return !free.contains(key) && !key.starts_with("render.");
}

}  // namespace

RunConfig load_run_config(const std::filesystem::path& path, std::span<const std::string> overrides) {
  return read_config(TomlConfig::from_file(path, overrides));
}

RunConfig parse_run_config(std::string_view text, std::string_view name,
                           std::span<const std::string> overrides) {
  return read_config(TomlConfig::from_text(text, name, overrides));
}

CascadeOptions cascade_options(const RunConfig& config, int stage) {
  return {.network = {.variant = config.model.variant,
                      .input_channels = input_channels(config.model.encode),
                      .image_size = config.model.image_size,
                      .width = config.model.width},
          .stage = stage,
          .reconstruction = config.model.reconstruction && config.loss.reconstruction.weight > 0.0,
          .checkpoint = config.train.activation_checkpointing,
          .skip = config.model.skip,
          .dilation = config.model.skip_dilation,
          .illumination_downscale = config.model.illumination_downscale};
}

AdamOptions adam_options(const RunConfig& config, int stage) {
  return {.learning_rate = config.stages[static_cast<size_t>(stage - 1)].learning_rate,
          .beta1 = config.train.beta1,
          .beta2 = config.train.beta2,
          .eps = config.train.eps};
}

std::vector<std::string> config_differences(std::string_view before, std::string_view now) {
  const auto old_keys = flat_keys(before);
  const auto new_keys = flat_keys(now);
  const auto value = [](const std::map<std::string, std::string>& keys, const std::string& key) {
    const auto found = keys.find(key);
    return found == keys.end() ? std::string("(absent)") : found->second;
  };
  std::set<std::string> names;
  for (const auto& [key, text] : old_keys) names.insert(key);
  for (const auto& [key, text] : new_keys) names.insert(key);
  std::vector<std::string> lines;
  for (const std::string& key : names) {
    const std::string a = value(old_keys, key);
    const std::string b = value(new_keys, key);
    if (a != b && decides_numbers(key)) lines.push_back(fmt::format("{}: {} -> {}", key, a, b));
  }
  return lines;
}

}  // namespace opaline
