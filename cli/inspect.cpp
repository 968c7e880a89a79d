// `opaline inspect`: what is in a file or folder of any kind that opaline reads or writes.
#include <algorithm>
#include <cmath>
#include <filesystem>
#include <iostream>
#include <memory>
#include <string>
#include <vector>

#include "cli/commands.h"
#include "core/file.h"
#include "core/safetensors.h"
#include "data/dataset.h"
#include "data/exr.h"
#include "data/npy.h"
#include "data/png.h"
#include "train/checkpoint.h"
#include "train/run_folder.h"

namespace opaline::cli {
namespace {

namespace fs = std::filesystem;

/// Smallest, largest and mean value of those that are finite, and the number of the others.
struct Statistics {
  double min = HUGE_VAL;
  double max = -HUGE_VAL;
  double sum = 0;
  int64_t finite = 0;
  int64_t odd = 0;

  void add(double x) {
    if (!std::isfinite(x)) {
      ++odd;
      return;
    }
    min = std::min(min, x);
    max = std::max(max, x);
    sum += x;
    ++finite;
  }
  std::string text() const {
    std::string line = "no finite values";
    if (finite > 0) {
      line =
          fmt::format("min {:<12.6g} max {:<12.6g} mean {:.6g}", min, max, sum / static_cast<double>(finite));
    }
    if (odd > 0) line += fmt::format("  ({} NaN or infinite)", odd);
    return line;
  }
};

void inspect_exr(const fs::path& path) {
  const std::vector<std::byte> bytes = read_file(path);
  const ExrReader reader(bytes, path.string());
  fmt::print("EXR, {} x {} pixels, {} parts\n", reader.width(), reader.height(), reader.parts().size());
  for (const ExrPartInfo& info : reader.parts()) {
    const ExrPart part = reader.read(info.name);
    fmt::print("part '{}', window {}, {}\n", info.name, to_string(info.window), part.half ? "half" : "float");
    const size_t channels = part.channels.size();
    for (size_t c = 0; c < channels; ++c) {
      Statistics statistics;
      for (size_t i = c; i < part.pixels.size(); i += channels) {
        statistics.add(static_cast<double>(part.pixels[i]));
      }
      fmt::print("  {:<12} {}\n", part.channels[c], statistics.text());
    }
  }
}

void inspect_png(const fs::path& path) {
  const PngImage image = read_png(path);
  fmt::print("PNG, {} x {} pixels, {} bits\n", image.width, image.height, image.bits);
  const auto channels = static_cast<size_t>(image.channels);
  for (size_t c = 0; c < channels; ++c) {
    Statistics statistics;
    for (size_t i = c; i < image.samples.size(); i += channels) statistics.add(image.samples[i]);
    fmt::print("  {:<12} {}\n", channels == 1 ? "grey" : std::string(1, "RGB"[c]), statistics.text());
  }
}

void inspect_npy(const fs::path& path) {
  const NpyArray array = read_npy(path);
  Statistics statistics;
  for (const double value : array.values) statistics.add(value);
  fmt::print("npy, shape ({})\n  {}\n", fmt::join(array.shape, ", "), statistics.text());
}

void inspect_safetensors(const fs::path& path) {
  const SafetensorsFile file = load_safetensors(path);
  int64_t values = 0;
  for (const auto& [name, tensor] : file.tensors) values += tensor.numel();
  fmt::print("safetensors, {} tensors, {} values\n", file.tensors.size(), values);
  for (const auto& [key, value] : file.metadata) fmt::print("  metadata {} = {}\n", key, value);
  for (const auto& [name, tensor] : file.tensors) {
    Statistics statistics;
    for (int64_t i = 0; i < tensor.numel(); ++i) statistics.add(tensor.at(i));
    fmt::print("  {:<48} {:<9} {:<16} {}\n", name, to_string(tensor.dtype()), to_string(tensor.shape()),
               statistics.text());
  }
}

void inspect_dataset(const fs::path& path) {
  const std::unique_ptr<Dataset> dataset = open_dataset(path);
  const DatasetFacts& facts = dataset->facts();
  fmt::print("data set, {} layout, fingerprint {}\n", facts.layout, facts.fingerprint);
  if (facts.width > 0) fmt::print("  {} x {} pixels\n", facts.width, facts.height);
  for (const Split split : {Split::kTrain, Split::kTest}) {
    const int64_t size = dataset->size(split);
    fmt::print(
        "  {}: {} scenes{}\n", to_string(split), size,
        size > 0 ? fmt::format(", {} to {}", dataset->id(split, 0), dataset->id(split, size - 1)) : "");
  }
}

void inspect_checkpoint(const fs::path& path) {
  fmt::print("checkpoint {}\n", path.filename().string());
  std::vector<fs::path> files;
  for (const fs::directory_entry& entry : fs::directory_iterator(path)) files.push_back(entry.path());
  std::sort(files.begin(), files.end());
  for (const fs::path& file : files) {
    fmt::print("  {:<32} {:>12} bytes\n", file.filename().string(), fs::file_size(file));
  }
}

void inspect_run(const RunFolder& run) {
  const std::vector<fs::path> checkpoints = list_checkpoints(run.checkpoints());
  fmt::print("run folder, {} checkpoints\n", checkpoints.size());
  if (fs::exists(run.metrics())) {
    const std::string text = read_text(run.metrics());
    fmt::print("  metrics.jsonl: {} events\n", std::count(text.begin(), text.end(), '\n'));
  }
  for (const fs::path& checkpoint : checkpoints) inspect_checkpoint(checkpoint);
  if (fs::exists(run.config())) fmt::print("config.toml:\n{}", read_text(run.config()));
}

void inspect_folder(const fs::path& path) {
  const RunFolder run{path};
  if (fs::is_directory(run.checkpoints())) return inspect_run(run);
  if (fs::exists(path / "state.json")) return inspect_checkpoint(path);
  inspect_dataset(path);
}

void inspect(const fs::path& path) {
  if (!fs::exists(path)) fail_usage("inspect", "there is no {}", path.string());
  if (fs::is_directory(path)) return inspect_folder(path);
  const std::string extension = path.extension().string();
  if (extension == ".exr") return inspect_exr(path);
  if (extension == ".png") return inspect_png(path);
  if (extension == ".npy") return inspect_npy(path);
  if (extension == ".safetensors") return inspect_safetensors(path);
  fail_usage("inspect", "{} is none of .exr, .png, .npy, .safetensors", path.string());
}

}  // namespace

void add_inspect(CLI::App& app, Outcome&) {
  const auto path = std::make_shared<fs::path>();
  CLI::App* command = app.add_subcommand(
      "inspect", "List what a file (EXR, PNG, npy, safetensors) or folder (data set, run, checkpoint) holds");
  command->add_option("path", *path, "file or folder")->required();
  command->callback([path] { inspect(*path); });
}

}  // namespace opaline::cli
