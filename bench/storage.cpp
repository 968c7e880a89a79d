// bench_storage: how scenes are best stored. Writes the scenes of a data set in every lossless compression,
// as half floats and as floats; prints their size, the CPU time of reading them, and what half floats cost in
// accuracy.
#include <fcntl.h>
#include <unistd.h>

#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "core/clock.h"
#include "core/error.h"
#include "data/encode.h"
#include "data/scene_set.h"

namespace opaline::bench {
namespace {

namespace fs = std::filesystem;

struct Arguments {
  std::string data;
  std::string work;
  int64_t scenes = 16;
  int repeats = 5;
};

/// Of the model in column "disk": one reader of a solid-state disk or a fast network.
constexpr double kDiskBytesPerSecond = 500e6;

constexpr std::array<std::string_view, 5> kNames = {"none", "rle", "zips", "zip", "piz"};

/// Files hold half floats already: an exposure makes values of them that need all bits of a float.
constexpr float kGain = 0.8137F;

SceneImages float_images(const Scene& scene) {
  SceneImages images{.width = scene.width, .height = scene.height};
  images.image = scene.image;
  images.bsdf = scene.bsdf;
  for (float& value : images.image) value *= kGain;
  for (float& value : images.bsdf) value *= kGain;
  images.normal = scene.normal;
  images.depth = scene.depth;
  for (float& value : images.depth) value *= kGain;
  images.coverage.assign(scene.mask.begin(), scene.mask.end());
  return images;
}

void write_set(const fs::path& root, const std::vector<SceneImages>& scenes, const SceneStorage& storage,
               double& write_cpu, int64_t& bytes) {
  std::vector<SceneRecord> records;
  const double begin = thread_cpu_seconds();
  for (size_t i = 0; i < scenes.size(); ++i) {
    SceneRecord& record = records.emplace_back();
    record.id = std::to_string(i);
    bytes += write_scene(root, static_cast<int64_t>(i), scenes[i], record, storage).bytes;
  }
  write_cpu = thread_cpu_seconds() - begin;
  write_scene_index(root / "train.jsonl", records);
  write_scene_set_info(root, {.generator_version = "storage",
                              .train = static_cast<int64_t>(scenes.size()),
                              .width = scenes[0].width,
                              .height = scenes[0].height});
}

/// Drops the files from the page cache.
void make_cold(const fs::path& root) {
  for (const fs::directory_entry& entry : fs::directory_iterator(root / "scenes")) {
    const int file = ::open(entry.path().c_str(), O_RDONLY | O_CLOEXEC);
    ::posix_fadvise(file, 0, 0, POSIX_FADV_DONTNEED);
    ::close(file);
  }
}

/// Loading a scene: the median over passes of the mean over scenes.
struct LoadTime {
  double cpu = 0.0;  ///< milliseconds, the system's part included
  double bytes = 0.0;
};

LoadTime time_loads(const Dataset& dataset, const fs::path& root, int stage, bool cold, int repeats) {
  const LoadOptions options{.bsdf = stage == 2, .truth = true, .whole = stage == 2};
  std::vector<double> cpu;
  LoadTime time;
  const auto n = static_cast<double>(dataset.size(Split::kTrain));
  for (int repeat = -1; repeat < repeats; ++repeat) {
    if (cold) make_cold(root);
    const int64_t bytes = bytes_read();
    const double cpu_begin = thread_cpu_seconds();
    for (int64_t i = 0; i < dataset.size(Split::kTrain); ++i) dataset.load(Split::kTrain, i, options);
    if (repeat < 0) continue;
    cpu.push_back(1e3 * (thread_cpu_seconds() - cpu_begin) / n);
    time.bytes = static_cast<double>(bytes_read() - bytes) / n;
  }
  time.cpu = median(cpu);
  return time;
}

/// Largest and root-mean-square difference over pixels that count.
struct Difference {
  double largest = 0.0;
  double squares = 0.0;
  int64_t count = 0;

  void add(double difference) {
    if (!(std::abs(difference) <= largest)) largest = std::abs(difference);
    squares += difference * difference;
    ++count;
  }
  std::string text() const {
    return fmt::format("{:.1e} | {:.1e}", std::sqrt(squares / static_cast<double>(count)), largest);
  }
};

void compare(const fs::path& half_root, const fs::path& float_root) {
  const auto half_set = open_dataset(half_root);
  const auto float_set = open_dataset(float_root);
  Difference stokes, dop, values, normal, depth;
  EncodeOptions network = EncodeOptions::paper();
  EncodeOptions ratio;
  ratio.inputs = {InputKind::kDopAop};
  for (int64_t i = 0; i < half_set->size(Split::kTrain); ++i) {
    const Scene a = half_set->load(Split::kTrain, i);
    const Scene b = float_set->load(Split::kTrain, i);
    for (size_t k = 0; k < a.image.size(); ++k) {
      const size_t s0 = k / kStokesChannels * kStokesChannels + k % 3;
      if (b.image[s0] > 0.0F) stokes.add(static_cast<double>((a.image[k] - b.image[k]) / b.image[s0]));
    }
    for (size_t k = 0; k < a.normal.size(); ++k) normal.add(static_cast<double>(a.normal[k] - b.normal[k]));
    for (size_t k = 0; k < a.depth.size(); ++k) depth.add(static_cast<double>(a.depth[k] - b.depth[k]));
    const Tensor x = encode_scene(a, network).input;
    const Tensor y = encode_scene(b, network).input;
    for (int64_t k = 0; k < x.numel(); ++k) values.add(x.at(k) - y.at(k));
    const Tensor p = encode_scene(a, ratio).input;
    const Tensor q = encode_scene(b, ratio).input;
    for (int64_t k = 0; k < p.numel(); ++k) {
      if (k % 6 < 3) dop.add(p.at(k) - q.at(k));
    }
  }
  fmt::print("\nHalf floats against floats:\n\n| quantity | RMS | largest |\n|---|---:|---:|\n");
  fmt::print("| S0, S1, S2 over S0 | {} |\n| DoP | {} |\n", stokes.text(), dop.text());
  fmt::print("| network input (2 v - 1) | {} |\n| normal | {} |\n| depth | {} |\n", values.text(),
             normal.text(), depth.text());
}

void run(const Arguments& arguments) {
  const auto source = open_dataset(arguments.data);
  std::vector<SceneImages> scenes;
  for (int64_t i = 0; i < std::min(arguments.scenes, source->size(Split::kTrain)); ++i) {
    scenes.push_back(float_images(source->load(Split::kTrain, i)));
  }
  if (scenes.empty()) fail(arguments.data, "has no training scenes");
  const auto n = static_cast<double>(scenes.size());
  fmt::print("{}: {} scenes of {} x {}; a scene:\n\n", arguments.data, scenes.size(), scenes[0].width,
             scenes[0].height);
  fmt::print(
      "| stored | kB | write ms | stage 1 kB | warm ms | cold ms | disk ms | stage 2 kB | warm ms | cold ms "
      "| disk ms |\n"
      "|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|\n");
  for (const bool half : {true, false}) {
    for (size_t c = 0; c < kNames.size(); ++c) {
      const std::string name = fmt::format("{} {}", half ? "half" : "float", kNames[c]);
      const fs::path root = fs::path(arguments.work) / name;
      fs::remove_all(root);
      double write_cpu = 0.0;
      int64_t bytes = 0;
      write_set(root, scenes, {.compression = static_cast<ExrCompression>(c), .half = half}, write_cpu,
                bytes);
      const auto dataset = open_dataset(root);
      const auto time = [&](int stage, bool cold) {
        return time_loads(*dataset, root, stage, cold, arguments.repeats);
      };
      fmt::print("| {} | {:.0f} | {:.1f} |", name, 1e-3 * static_cast<double>(bytes) / n,
                 1e3 * write_cpu / n);
      for (const int stage : {1, 2}) {
        const LoadTime warm = time(stage, false);
        const double disk = warm.cpu + 1e3 * warm.bytes / kDiskBytesPerSecond;
        fmt::print(" {:.0f} | {:.2f} | {:.2f} | {:.2f} |", 1e-3 * warm.bytes, warm.cpu, time(stage, true).cpu,
                   disk);
      }
      fmt::print("\n");
      std::fflush(stdout);
    }
  }
  compare(fs::path(arguments.work) / "half none", fs::path(arguments.work) / "float none");
  fs::remove_all(arguments.work);
}

}  // namespace
}  // namespace opaline::bench

int main(int argc, char** argv) {
  CLI::App app{
      "Sizes and CPU times of scenes by compression and type, and the error of half floats. Warm: from the "
      "page\n"
      "cache; cold: after dropping the files from it; disk: warm CPU time and the bytes at 500 MB/s, one "
      "after\n"
      "the other"};
  opaline::bench::Arguments arguments;
  app.add_option("data", arguments.data, "Data set of ours")->required();
  app.add_option("--work", arguments.work, "Folder for the variants; it is removed at the end")->required();
  app.add_option("--scenes", arguments.scenes, "The first so many")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  app.add_option("--repeats", arguments.repeats, "Passes, after one that warms")->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  try {
    opaline::bench::run(arguments);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_storage: %s\n", error.what());
    return 1;
  }
  return 0;
}
