// The config of a run: one TOML file for rendering, data, model and training.
//
//   [render]   what `opaline render` makes (data/generate.h); training only checks it
//   [data]     where the scenes are and how they are read
//   [model]    variant, sizes, inputs
//   [train]    seed, batches, optimiser, log and checkpoints
//   [stage1] [stage2]   epochs, learning rate, frozen networks
//   [loss]     weight and kind of each term
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/numerics.h"
#include "data/encode.h"
#include "data/generate.h"
#include "data/loader.h"
#include "data/sensor.h"
#include "models/cascade.h"
#include "nn/optim.h"
#include "train/evaluate.h"
#include "train/losses.h"

namespace opaline {

struct DataConfig {
  std::string path;         ///< data set folder; relative to the working folder
  int64_t max_scenes = 0;   ///< of the training split; 0: all
  int64_t threads = 1;      ///< that read and encode
  int64_t prefetch = 3;     ///< micro-batches held ready
  int64_t cache_mib = 512;  ///< decoded scenes kept in memory
  DamagePolicy damaged = DamagePolicy::kFail;
  CaptureOptions capture = {};  ///< exposure and sensor model of training; off by default
};

struct ModelConfig {
  Variant variant = Variant::kPaper;
  int64_t image_size = 256;
  int64_t width = 64;
  EncodeOptions encode = EncodeOptions::paper();  ///< the variant's, with the inputs of the config
  bool reconstruction = true;
  Skip skip = Skip::kSupport;          ///< where the image networks compute (models/cascade.h)
  int64_t skip_dilation = 0;           ///< tiles around the mask's that are computed too
  int64_t illumination_downscale = 1;  ///< of the images that the illumination network sees
};

/// How the learning rate falls (nn/schedule.h); each stage has its own.
enum class Schedule { kStep, kEpoch, kConstant };

struct StageConfig {
  int64_t epochs = 20;
  double learning_rate = 2e-4;
  /// Networks whose weights and running statistics stay as they are.
  std::vector<std::string> freeze;
};

struct TrainConfig {
  uint64_t seed = 1;
  int64_t batch = 64;        ///< images of an optimiser step
  int64_t micro_batch = 16;  ///< images of a forward pass; batch statistics are over these
  double beta1 = 0.5;
  double beta2 = 0.999;
  double eps = 1e-8;
  Numerics numerics = Numerics::kBalanced;  ///< which algorithms convolutions may take (core/numerics.h)
  bool activation_checkpointing = false;    ///< less memory for about a third more time (CascadeOptions)
  Schedule schedule = Schedule::kStep;
  int64_t log_every = 10;        ///< steps
  int64_t checkpoint_every = 0;  ///< steps, besides every epoch's end; 0: none
  int64_t keep = 2;              ///< newest checkpoints kept
  int64_t eval_scenes = 32;      ///< test scenes measured after every epoch; 0: none
  EvaluateColumns eval_columns;  ///< what is measured of them
  int64_t threads = 0;           ///< of the computation; 0: all cores
};

struct RunConfig {
  GenerateConfig render;
  DataConfig data;
  ModelConfig model;
  TrainConfig train;
  std::array<StageConfig, 2> stages;
  LossOptions loss;

  std::string text;                   ///< resolved TOML, every key with the value in force
  std::vector<std::string> warnings;  ///< what is allowed, but seldom wise
};

/// Reads a config with `--set` overrides ("train.batch=32"). Throws UsageError with everything that is wrong,
/// each with its line.
RunConfig load_run_config(const std::filesystem::path& path, std::span<const std::string> overrides = {});
RunConfig parse_run_config(std::string_view text, std::string_view name,
                           std::span<const std::string> overrides = {});

/// The cascade of a stage as configured.
CascadeOptions cascade_options(const RunConfig& config, int stage);
AdamOptions adam_options(const RunConfig& config, int stage);

/// Lines "table.key: old -> new" for all that differs between two resolved configs and decides the numbers:
/// paths, threads, caches, what is kept and [render] may differ.
std::vector<std::string> config_differences(std::string_view before, std::string_view now);

}  // namespace opaline
