// `opaline bench skip`: what computing on an object's tiles alone saves, and what it changes.
#include <fmt/ranges.h>

#include <cmath>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "cli/bench.h"
#include "cli/bench_workload.h"
#include "cli/numerics_option.h"
#include "core/autograd.h"
#include "core/clock.h"
#include "core/error.h"
#include "core/file.h"
#include "core/memory.h"
#include "core/numerics.h"
#include "data/chart.h"
#include "train/evaluate.h"
#include "train/graph.h"
#include "train/trained_model.h"

namespace opaline::cli {
namespace {

struct SkipArguments {
  Workload workload{.net = "stage2", .batch = 2};
  std::vector<std::string> masks{"0.05", "0.1", "0.2", "0.27", "0.4", "0.6", "0.8", "1"};
  int64_t illumination_downscale = 1;  ///< where something is skipped
  int64_t repeats = 3;
  Numerics numerics = Numerics::kBalanced;
  bool forward_only = false;
  std::vector<std::filesystem::path> runs;
  std::string plot;
  bool json = false;
};

/// One way to do a step: everything, or the support alone.
struct Way {
  std::unique_ptr<Step> step;
  bool forward_only;
  int64_t held = 0;   ///< bytes of gradients
  int64_t peak = 0;   ///< bytes beyond these
  int64_t moved = 0;  ///< bytes, counted (train/graph.h)
  std::vector<double> seconds = {};

  Way(const Workload& workload, bool forward) : step(make_step(workload)), forward_only(forward) {
    step->set_training(!forward_only);
  }
  void run(bool timed) {
    const double begin = wall_seconds();
    if (forward_only) {
      const NoGradGuard no_grad;
      step->forward();
    } else {
      step->go_backward(step->forward());
    }
    if (timed) seconds.push_back(wall_seconds() - begin);
    step->zero_grad();
  }
  /// Work and memory of a first run, which also warms up.
  void count() {
    {
      const Tensor result = step->forward();
      const WorkCount work = count_work(result);
      moved = work.forward_bytes + (forward_only ? 0 : work.backward_bytes);
    }
    for (const NamedTensor& parameter : step->parameters()) {
      if (!forward_only) held += parameter.tensor.byte_size();
    }
    const int64_t before = tensor_pool().bytes_in_use();
    tensor_pool().reset_peak();
    run(false);
    peak = tensor_pool().peak_bytes() - before - held;
  }
};

struct Row {
  std::string mask;
  double share = 0.0;  ///< of the tiles
  double dense = 0.0, seconds = 0.0;
  int64_t dense_peak = 0, peak = 0;
  int64_t dense_moved = 0, moved = 0;
};

Row measure(const SkipArguments& arguments, const std::string& mask) {
  Workload workload = arguments.workload;
  workload.mask = mask;
  Row row{.mask = std::filesystem::is_regular_file(mask) ? std::filesystem::path(mask).filename().string()
                                                         : fmt::format("{:g} %", 100.0 * std::stod(mask))};
  Way dense(workload, arguments.forward_only);
  workload.skip = true;
  workload.illumination_downscale = arguments.illumination_downscale;
  Way skipping(workload, arguments.forward_only);
  tensor_pool().release_cached();
  dense.count();
  skipping.count();
  for (int64_t turn = 0; turn < arguments.repeats; ++turn) {
    dense.run(true);
    skipping.run(true);
  }
  row.share = skipping.step->computed_share();
  row.dense = median(dense.seconds);
  row.seconds = median(skipping.seconds);
  row.dense_peak = dense.peak;
  row.peak = skipping.peak;
  row.dense_moved = dense.moved;
  row.moved = skipping.moved;
  return row;
}

/// What skipping changes in a trained cascade's results on its test scenes.
struct Change {
  std::string run, trained;
  EvaluationSummary none, support;
};

Change compare(const std::filesystem::path& run) {
  const auto warn = [](std::string_view line) { fmt::print(stderr, "warning: {}\n", line); };
  const TrainedModel model = load_trained_model({run}, warn);
  const NumericsGuard numerics(model.config.train.numerics);
  const std::shared_ptr<const Dataset> dataset = open_dataset(model.config.data.path);
  Change change{run.filename().string(), std::string(to_string(model.config.model.skip)), {}, {}};
  for (const Skip skip : {Skip::kNone, Skip::kSupport}) {
    model.cascade->set_skip(skip);
    const EvaluateOptions options{.threads = static_cast<int>(model.config.data.threads),
                                  .damaged = model.config.data.damaged,
                                  .warn = warn};
    (skip == Skip::kNone ? change.none : change.support) =
        summarize(evaluate(*model.cascade, dataset, model.config.model.encode, nullptr, options));
  }
  return change;
}

void print_changes(const std::vector<Change>& changes) {
  fmt::print("\nErrors on the test scenes, computed everywhere and on the support:\n\n");
  fmt::print("| run | trained with skip | {} |\n|---|---|{}\n", fmt::join(kMetricNames, " | "), [] {
    std::string line;
    for (size_t m = 0; m < kMetricCount; ++m) line += "---|";
    return line;
  }());
  for (const Change& change : changes) {
    std::vector<std::string> cells;
    for (size_t m = 0; m < kMetricCount; ++m) {
      const auto &none = change.none.cascade[m], &support = change.support.cascade[m];
      cells.push_back(none && support ? fmt::format("{:.4g}, {:.4g}", *none, *support) : "-");
    }
    fmt::print("| {} | {} | {} |\n", change.run, change.trained, fmt::join(cells, " | "));
  }
}

std::string plot(const std::vector<Row>& rows, const SkipArguments& arguments) {
  ChartSeries time{.name = "time", .colour = "#1f77b4", .points = {}, .markers = true, .line = false};
  ChartSeries memory{.name = "memory", .colour = "#d62728", .points = {}, .markers = true, .line = false};
  ChartSeries bytes{.name = "bytes moved", .colour = "#2ca02c", .points = {}, .markers = true, .line = false};
  for (const Row& row : rows) {
    time.points.push_back({row.share, row.seconds / row.dense});
    memory.points.push_back({row.share, static_cast<double>(row.peak) /
                                            static_cast<double>(std::max<int64_t>(row.dense_peak, 1))});
    bytes.points.push_back(
        {row.share, static_cast<double>(row.moved) / static_cast<double>(row.dense_moved)});
  }
  const ChartSeries line{.name = "in proportion", .colour = "#999999", .points = {{0.0, 0.0}, {1.0, 1.0}}};
  const Workload& w = arguments.workload;
  return chart_sheet({render_chart({line, time, memory, bytes},
                                   {.title = fmt::format("{}, {} of {} x {}", w.net, w.batch, w.size, w.size),
                                    .x_label = "share of the tiles",
                                    .reference = 1.0,
                                    .reference_name = "everything",
                                    .width = 520,
                                    .height = 340})},
                     1, 520, 340);
}

void run_bench_skip(const SkipArguments& arguments) {
  if (arguments.workload.net == "cascade" && !arguments.forward_only) {
    fail_usage("bench skip", "cascade is what prediction computes: it needs --forward");
  }
  const NumericsGuard numerics(arguments.numerics);
  const auto mib = [](int64_t bytes) { return static_cast<double>(bytes) / (1 << 20); };
  std::vector<Row> rows;
  nlohmann::ordered_json json = {{"net", arguments.workload.net}, {"rows", nlohmann::ordered_json::array()}};
  if (!arguments.json) {
    const Workload& w = arguments.workload;
    fmt::print(
        "{}{}, {} x {} x {}, width {}: everything, and the support alone, in turns; memory beyond "
        "weights, gradients and inputs\n\n",
        w.net, arguments.forward_only ? " forward" : "", w.batch, w.size, w.size, w.width);
    fmt::print(
        "| mask | tiles | s | everything s | share of the time | MiB | everything MiB | share | GB moved | "
        "everything GB | share |\n|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|\n");
  }
  for (const std::string& mask : arguments.masks) {
    const Row row = measure(arguments, mask);
    rows.push_back(row);
    json["rows"].push_back({{"mask", row.mask},
                            {"tiles", row.share},
                            {"seconds", row.seconds},
                            {"dense_seconds", row.dense},
                            {"peak_beyond", row.peak},
                            {"dense_peak_beyond", row.dense_peak},
                            {"moved", row.moved},
                            {"dense_moved", row.dense_moved}});
    if (arguments.json) continue;
    const auto percent = [](double part, double whole) {
      return whole > 0.0 ? fmt::format("{:.1f} %", 100.0 * part / whole) : std::string("-");
    };
    fmt::print("| {} | {:.1f} % | {:.4f} | {:.4f} | {} | {:.1f} | {:.1f} | {} | {:.2f} | {:.2f} | {} |\n",
               row.mask, 100.0 * row.share, row.seconds, row.dense, percent(row.seconds, row.dense),
               mib(row.peak), mib(row.dense_peak), percent(mib(row.peak), mib(row.dense_peak)),
               1e-9 * static_cast<double>(row.moved), 1e-9 * static_cast<double>(row.dense_moved),
               percent(static_cast<double>(row.moved), static_cast<double>(row.dense_moved)));
    std::fflush(stdout);
  }
  std::vector<Change> changes;
  for (const std::filesystem::path& run : arguments.runs) changes.push_back(compare(run));
  if (!arguments.plot.empty()) write_file_atomically(arguments.plot, std::string_view(plot(rows, arguments)));
  if (!arguments.json) {
    if (!changes.empty()) print_changes(changes);
    return;
  }
  for (const Change& change : changes) {
    json["runs"].push_back({{"run", change.run},
                            {"trained", change.trained},
                            {"none", to_json(change.none.cascade)},
                            {"support", to_json(change.support.cascade)}});
  }
  fmt::print("{}\n", json.dump());
}

}  // namespace

void add_bench_skip(CLI::App& bench) {
  const auto arguments = std::make_shared<SkipArguments>();
  CLI::App* command = bench.add_subcommand(
      "skip",
      "Time computing on the 16 x 16 tiles that touch the object alone beside computing everything, over "
      "the\n"
      "object's share of the image (a disc) or for masks in files: medians, taking turns; memory, and the "
      "bytes "
      "that operations\nmove. With --run, what it changes in a trained cascade's errors.");
  const std::vector<std::string> nets = workload_names();
  command->add_option("--net", arguments->workload.net, fmt::format("One of {}", fmt::join(nets, ", ")))
      ->check(CLI::IsMember(nets))
      ->capture_default_str();
  command->add_option("--mask", arguments->masks, "PNG files, or shares of the image such as 0.3 (a disc)")
      ->capture_default_str();
  command->add_option("--size", arguments->workload.size, "Image size")->capture_default_str();
  command->add_option("--batch", arguments->workload.batch, "Images")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--width", arguments->workload.width, "Channels of the first layer")
      ->capture_default_str();
  command
      ->add_option("--illumination-downscale", arguments->illumination_downscale,
                   "Where something is skipped, let the illumination network see images of this fraction "
                   "of the side")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--repeats", arguments->repeats, "Turns")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  add_numerics_option(*command, arguments->numerics);
  command->add_flag("--forward", arguments->forward_only, "The forward pass alone, in evaluation mode");
  command->add_option("--run", arguments->runs, "Run folders, whose data sets are where their configs say");
  command->add_option("--plot", arguments->plot, "Time, memory and bytes over the share of tiles, as SVG");
  command->add_flag("--json", arguments->json, "Print one JSON object");
  command->callback([arguments] { run_bench_skip(*arguments); });
}

}  // namespace opaline::cli
