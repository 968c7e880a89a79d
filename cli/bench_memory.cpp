// `opaline bench memory`: what predicting and training take.
#include <fmt/ranges.h>
#include <malloc.h>

#include <array>
#include <cstdio>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "cli/bench.h"
#include "cli/bench_workload.h"
#include "core/autograd.h"
#include "core/clock.h"
#include "core/memory.h"
#include "nn/optim.h"

namespace opaline::cli {
namespace {

struct MemoryArguments {
  Workload workload;
  std::vector<int64_t> batches{1, 2, 4};
  bool json = false;
};

/// A way to run a workload: a row of each batch. Another one is a line in kWays.
struct Way {
  std::string_view name;
  bool training = false;
  bool checkpoint = false;  ///< stages only
};
constexpr std::array kWays = {Way{"forward"}, Way{"training", true},
                              Way{"training, checkpoints", true, true}};

/// Whether there is such a step: the cascade is what prediction computes, and batch norms over vectors cannot
/// train on a single image.
bool exists(const Way& way, std::string_view net, int64_t batch) {
  if (!way.training) return true;
  if (way.checkpoint && net != "stage1" && net != "stage2") return false;
  const bool of_images =
      net == "normal" || net == "depth" || net == "reconstruction" || net == "illumination_decoder";
  return net != "cascade" && (batch > 1 || of_images);
}

/// Bytes.
struct Memory {
  int64_t weights = 0;
  int64_t gradients = 0;
  int64_t moments = 0;              ///< Adam's
  int64_t peak = 0;                 ///< of the storage pool, beyond these and the inputs
  int64_t graph = 0;                ///< held between forward and backward
  std::optional<int64_t> resident;  ///< growth of the process beyond the same, where the system tells it
  double seconds = 0.0;             ///< of a later run
};

Memory measure(Workload workload, const Way& way) {
  Pool& pool = tensor_pool();
  workload.checkpoint = way.checkpoint;
  const std::unique_ptr<Step> step = make_step(workload);
  step->set_training(way.training);
  Memory memory;
  for (const NamedTensor& parameter : step->parameters()) memory.weights += parameter.tensor.byte_size();
  std::optional<Adam> adam;
  if (way.training) {
    memory.gradients = memory.weights;
    const int64_t before = pool.bytes_in_use();
    adam.emplace(step->parameters());
    memory.moments = pool.bytes_in_use() - before;
  }
  const int64_t before = pool.bytes_in_use();
  const auto run = [&] {
    if (!way.training) {
      const NoGradGuard no_grad;
      step->forward();
      return;
    }
    const Tensor result = step->forward();
    memory.graph = pool.bytes_in_use() - before;
    step->go_backward(result);
    adam->step();
  };

  // What earlier rows left free must not serve this one unseen.
  pool.release_cached();
  malloc_trim(0);
  const int64_t resident_before = resident_bytes();
  pool.reset_peak();
  const bool told = reset_resident_peak() && resident_before > 0;
  run();
  memory.peak = pool.peak_bytes() - before - memory.gradients;
  if (told) memory.resident = resident_peak_bytes() - resident_before - memory.gradients;

  std::vector<double> seconds;
  for (int i = 0; i < 3; ++i) {
    step->zero_grad();
    const double begin = wall_seconds();
    run();
    seconds.push_back(wall_seconds() - begin);
  }
  memory.seconds = median(seconds);
  return memory;
}

struct Row {
  int64_t batch;
  std::string_view way;
  Memory memory;
};

void print_head(const Workload& workload) {
  fmt::print("{}, {} x {} images, width {}; MiB\n\n", workload.net, workload.size, workload.size,
             workload.width);
  fmt::print(
      "| batch | way | weights | gradients | moments | peak beyond these | held by the graph | growth of the "
      "process | s |\n"
      "|---:|---|---:|---:|---:|---:|---:|---:|---:|\n");
}

void print_row(const Row& row) {
  const auto mib = [](int64_t bytes) {
    return fmt::format("{:.1f}", static_cast<double>(bytes) / (1 << 20));
  };
  const Memory& m = row.memory;
  fmt::print("| {} | {} | {} | {} | {} | {} | {} | {} | {:.3f} |\n", row.batch, row.way, mib(m.weights),
             mib(m.gradients), mib(m.moments), mib(m.peak), mib(m.graph), m.resident ? mib(*m.resident) : "",
             m.seconds);
  std::fflush(stdout);
}

nlohmann::ordered_json to_json(const Row& row) {
  const Memory& m = row.memory;
  nlohmann::ordered_json json = {
      {"batch", row.batch},   {"way", row.way},        {"weights", m.weights}, {"gradients", m.gradients},
      {"moments", m.moments}, {"peak_beyond", m.peak}, {"graph", m.graph},     {"resident_growth", nullptr},
      {"seconds", m.seconds}};
  if (m.resident) json["resident_growth"] = *m.resident;
  return json;
}

void run_bench_memory(const MemoryArguments& arguments) {
  Workload workload = arguments.workload;
  nlohmann::ordered_json json = {{"net", workload.net}, {"size", workload.size}, {"width", workload.width}};
  bool first = true;
  for (const int64_t batch : arguments.batches) {
    workload.batch = batch;
    for (const Way& way : kWays) {
      if (!exists(way, workload.net, batch)) continue;
      const Row row{batch, way.name, measure(workload, way)};
      if (arguments.json) {
        json["rows"].push_back(to_json(row));
        continue;
      }
      if (std::exchange(first, false)) print_head(workload);
      print_row(row);
    }
  }
  if (arguments.json) fmt::print("{}\n", json.dump());
}

}  // namespace

void add_bench_memory(CLI::App& bench) {
  const auto arguments = std::make_shared<MemoryArguments>();
  CLI::App* command = bench.add_subcommand(
      "memory",
      "What a forward pass alone, without graph, and a training step with Adam take: weights, gradients, "
      "moments;\n"
      "the peak of the storage pool beyond these and the inputs; what the graph holds between forward and "
      "backward;\n"
      "how much the process grew, from a system that tells, beyond the same; and the seconds of a later "
      "step. "
      "Stages\n"
      "also with activation checkpointing.");
  const std::vector<std::string> nets = workload_names();
  Workload& workload = arguments->workload;
  command->add_option("--net", workload.net, fmt::format("One of {}", fmt::join(nets, ", ")))
      ->required()
      ->check(CLI::IsMember(nets));
  command->add_option("--size", workload.size, "Image size")->capture_default_str();
  command->add_option("--width", workload.width, "Channels of the first layer")->capture_default_str();
  command->add_option("--batch", arguments->batches, "Numbers of images")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_flag("--json", arguments->json, "Print one JSON object, in bytes");
  command->callback([arguments] { run_bench_memory(*arguments); });
}

}  // namespace opaline::cli
