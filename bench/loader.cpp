// bench_loader: samples a second, CPU time and bytes of a sample, for both stages, whole and of the support.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/clock.h"
#include "core/error.h"
#include "core/memory.h"
#include "data/loader.h"

namespace opaline::bench {
namespace {

struct Arguments {
  std::string data;
  int64_t batch = 8;
  double seconds = 2.0;
  std::vector<int> threads = {1, 2};
  std::string variant = "paper";
  bool sensor = false;
};

struct Rates {
  double samples_per_second = 0.0;
  double cpu_milliseconds = 0.0;  ///< a sample, all threads
  double bytes = 0.0;             ///< read a sample
  double batch_bytes = 0.0;       ///< of a sample's tensors
};

int64_t byte_size(const Batch& batch) {
  int64_t bytes = 0;
  for (const Tensor* tensor : {&batch.input, &batch.normal, &batch.depth, &batch.mask, &batch.illumination,
                               &batch.sss, &batch.bsdf, &batch.polarised}) {
    if (tensor->defined()) bytes += tensor->byte_size();
  }
  return bytes;
}

Rates measure(const std::shared_ptr<const Dataset>& dataset, const Arguments& arguments, int stage,
              int threads, bool support) {
  LoaderOptions options{
      .batch = arguments.batch,
      .min_last = 1,
      .seed = 1,
      .threads = threads,
      .encode = arguments.variant == "paper" ? EncodeOptions::paper() : EncodeOptions::release(),
      .wanted = {.targets = true,
                 .reconstruction = stage == 2,
                 .support = support ? std::optional<int64_t>(0) : std::nullopt}};
  options.capture.sensor.on = arguments.sensor;
  Loader loader(dataset, options);
  for (int64_t i = 0; i < loader.batches_per_epoch(); ++i) loader.next();  // files and pool are warm then
  const double wall = wall_seconds();
  const double cpu = process_cpu_seconds();
  const int64_t bytes = bytes_read();
  int64_t samples = 0;
  int64_t held = 0;
  while (wall_seconds() - wall < arguments.seconds) {
    const std::optional<Batch> batch = loader.next();
    samples += batch->size();
    held += byte_size(*batch);
  }
  const auto n = static_cast<double>(samples);
  return {n / (wall_seconds() - wall), 1e3 * (process_cpu_seconds() - cpu) / n,
          static_cast<double>(bytes_read() - bytes) / n, static_cast<double>(held) / n};
}

void run(const Arguments& arguments) {
  const std::shared_ptr<const Dataset> dataset = open_dataset(arguments.data);
  const DatasetFacts& facts = dataset->facts();
  fmt::print("{} ({}): {} scenes of {} x {}, batches of {}{}\n\n", arguments.data, facts.layout,
             dataset->size(Split::kTrain), facts.width, facts.height, arguments.batch,
             arguments.sensor ? ", sensor model" : "");
  fmt::print(
      "| stage | images | threads | samples/s | CPU ms/sample | kB read/sample | kB of tensors/sample |\n"
      "|---|---|---:|---:|---:|---:|---:|\n");
  for (const int stage : {1, 2}) {
    for (const bool support : {false, true}) {
      for (const int threads : arguments.threads) {
        const Rates rates = measure(dataset, arguments, stage, threads, support);
        fmt::print("| {} | {} | {} | {:.0f} | {:.2f} | {:.0f} | {:.0f} |\n", stage,
                   support ? "support" : "whole", threads, rates.samples_per_second, rates.cpu_milliseconds,
                   1e-3 * rates.bytes, 1e-3 * rates.batch_bytes);
        std::fflush(stdout);
      }
    }
  }
}

}  // namespace
}  // namespace opaline::bench

int main(int argc, char** argv) {
  CLI::App app{
      "Samples a second that the loader gives from the page cache, the CPU time of a sample over all "
      "threads, and\n"
      "the bytes read and made for one, whole and on the tiles of the object alone; stage 2 with the "
      "pure-BSDF "
      "images"};
  opaline::bench::Arguments arguments;
  app.add_option("data", arguments.data, "Data set")->required();
  app.add_option("--batch", arguments.batch, "Samples of a batch")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  app.add_option("--seconds", arguments.seconds, "Time spent on one line")->capture_default_str();
  app.add_option("--threads", arguments.threads, "Numbers of threads")->capture_default_str();
  app.add_option("--variant", arguments.variant, "paper or release")
      ->check(CLI::IsMember({"paper", "release"}))
      ->capture_default_str();
  app.add_flag("--sensor", arguments.sensor, "With the sensor model");
  CLI11_PARSE(app, argc, argv);
  try {
    opaline::bench::run(arguments);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_loader: %s\n", error.what());
    return 1;
  }
  return 0;
}
