// `opaline bench runs`: the errors of training runs over the time that they took.
#include <array>
#include <cmath>
#include <filesystem>
#include <iostream>
#include <map>
#include <memory>
#include <optional>

#include "cli/bench.h"
#include "core/error.h"
#include "core/file.h"
#include "data/chart.h"
#include "train/config.h"
#include "train/log.h"
#include "train/metrics.h"
#include "train/run_folder.h"

namespace opaline::cli {
namespace {

namespace fs = std::filesystem;

struct RunsArguments {
  std::vector<fs::path> runs;
  std::vector<std::string> names;  ///< of the groups; empty: by what differs
  std::string plot;
  bool json = false;
};

/// One evaluation of a run's epoch.
struct Evaluation {
  int64_t stage = 0, epoch = 0;
  Metrics metrics{};
};

struct Run {
  std::string config;
  std::vector<Evaluation> evaluations;
  std::map<int64_t, std::vector<double>> epoch_seconds;  ///< by stage
};

/// Runs that differ by their seeds alone.
struct Group {
  std::string name;
  std::vector<Run> runs;
  std::map<int64_t, double> epoch_seconds = {};  ///< of an epoch of each stage
};

/// Columns of the log's evaluations, as to_json(Metrics) has them.
Metrics read_metrics(const nlohmann::json& event) {
  Metrics metrics;
  for (size_t m = 0; m < kMetricCount; ++m) {
    const std::string name(kMetricNames[m]);
    const nlohmann::json& from = m < kReleaseMetricCount ? event.at("release") : event;
    if (from.contains(name) && from.at(name).is_number()) metrics[m] = from.at(name).get<double>();
  }
  return metrics;
}

Run read_run(const fs::path& folder) {
  const RunFolder run{folder};
  if (!fs::is_directory(folder)) fail_usage("bench runs", "there is no run folder {}", folder.string());
  Run result{.config = read_text(run.config().string()), .evaluations = {}, .epoch_seconds = {}};
  for (const nlohmann::json& event : read_events(run.metrics())) {
    const std::string kind = event.value("event", "");
    const int64_t stage = event.value("stage", int64_t{0});
    if (kind == "epoch" && event.contains("wall")) {
      result.epoch_seconds[stage].push_back(event.at("wall").value("seconds", 0.0));
    } else if (kind == "eval") {
      result.evaluations.push_back({stage, event.value("epoch", int64_t{0}), read_metrics(event)});
    }
  }
  if (result.evaluations.empty()) {
    fail("bench runs", "{} has no evaluations (train.eval_scenes = 0, or it ended before an epoch)",
         run.metrics().string());
  }
  return result;
}

/// How a config differs from the first run's, seeds and evaluations aside: new values by key. "a.b: x -> y"
/// gives b and {x, y}.
std::map<std::string, std::pair<std::string, std::string>> differences(const std::string& first,
                                                                       const std::string& config) {
  std::map<std::string, std::pair<std::string, std::string>> result;
  for (const std::string& line : config_differences(first, config)) {
    if (line.starts_with("train.seed:") || line.starts_with("train.eval_")) continue;
    const size_t colon = line.find(": ");
    const size_t arrow = line.find(" -> ", colon);
    std::string before = line.substr(colon + 2, arrow - colon - 2);
    std::string after = line.substr(arrow + 4);
    for (std::string* text : {&before, &after})
      std::erase_if(*text, [](char c) { return c == '\'' || c == '"'; });
    result.emplace(line.substr(0, colon), std::pair(std::move(before), std::move(after)));
  }
  return result;
}

/// Each group's values of the keys that differ between groups: "skip = none", "skip = support".
void name_groups(std::vector<Group>& groups) {
  std::map<std::string, std::string> first_values;
  const std::string& first = groups.front().runs.front().config;
  for (const Group& group : groups) {
    for (const auto& [key, values] : differences(first, group.runs.front().config)) {
      first_values.emplace(key, values.first);
    }
  }
  for (Group& group : groups) {
    const auto changed = differences(first, group.runs.front().config);
    std::vector<std::string> parts;
    for (const auto& [key, first_value] : first_values) {
      const auto found = changed.find(key);
      const std::string& value = found == changed.end() ? first_value : found->second.second;
      parts.push_back(fmt::format("{} = {}", key.substr(key.rfind('.') + 1), value));
    }
    group.name = parts.empty() ? "all runs" : fmt::format("{}", fmt::join(parts, ", "));
  }
}

double median_of(std::vector<double> values) {
  std::sort(values.begin(), values.end());
  const size_t n = values.size();
  return n % 2 == 1 ? values[n / 2] : 0.5 * (values[n / 2 - 1] + values[n / 2]);
}

std::vector<Group> read_groups(const std::vector<fs::path>& folders) {
  std::vector<Group> groups;
  for (const fs::path& folder : folders) {
    Run run = read_run(folder);
    auto group = std::ranges::find_if(groups, [&](const Group& other) {
      return differences(other.runs.front().config, run.config).empty();
    });
    if (group == groups.end()) {
      group = groups.insert(groups.end(), Group{.name = {}, .runs = {}});
    } else if (group->runs.front().evaluations.size() != run.evaluations.size()) {
      fail("bench runs", "{} has {} evaluations, another run of its config {}: has it ended?",
           folder.string(), run.evaluations.size(), group->runs.front().evaluations.size());
    }
    group->runs.push_back(std::move(run));
  }
  // An epoch's median over the group, so that what else the machine did in one of them does not count.
  for (Group& group : groups) {
    std::map<int64_t, std::vector<double>> all;
    for (const Run& run : group.runs) {
      for (const auto& [stage, seconds] : run.epoch_seconds) {
        all[stage].insert(all[stage].end(), seconds.begin(), seconds.end());
      }
    }
    for (auto& [stage, seconds] : all) group.epoch_seconds[stage] = median_of(std::move(seconds));
  }
  name_groups(groups);
  return groups;
}

/// Seconds of training until each evaluation.
std::vector<double> times(const Group& group) {
  std::vector<double> result;
  double sum = 0.0;
  for (const Evaluation& evaluation : group.runs.front().evaluations) {
    const auto seconds = group.epoch_seconds.find(evaluation.stage);
    sum += seconds == group.epoch_seconds.end() ? 0.0 : seconds->second;
    result.push_back(sum);
  }
  return result;
}

struct Spread {
  double mean = 0.0;
  std::optional<double> deviation = {};  ///< of several runs
};

/// A column of evaluation i over a group's runs; nothing where one of them lacks it.
std::optional<Spread> spread(const Group& group, size_t i, size_t metric) {
  std::vector<double> values;
  for (const Run& run : group.runs) {
    const auto& value = run.evaluations[i].metrics[metric];
    if (!value) return std::nullopt;
    values.push_back(*value);
  }
  Spread result;
  for (const double value : values) result.mean += value / static_cast<double>(values.size());
  if (values.size() < 2) return result;
  double sum = 0.0;
  for (const double value : values) sum += (value - result.mean) * (value - result.mean);
  result.deviation = std::sqrt(sum / static_cast<double>(values.size() - 1));
  return result;
}

void print_table(const std::vector<Group>& groups) {
  fmt::print("| config | runs | time, s |");
  for (const std::string_view name : kMetricNames) fmt::print(" {} |", name);
  fmt::print("\n|---|---:|---:|");
  for (size_t m = 0; m < kMetricCount; ++m) fmt::print("---:|");
  fmt::print("\n");
  for (const Group& group : groups) {
    fmt::print("| {} | {} | {:.0f} |", group.name, group.runs.size(), times(group).back());
    for (size_t m = 0; m < kMetricCount; ++m) {
      const auto value = spread(group, group.runs.front().evaluations.size() - 1, m);
      if (!value) {
        fmt::print(" - |");
      } else if (value->deviation) {
        fmt::print(" {:.4g} ± {:.2g} |", value->mean, *value->deviation);
      } else {
        fmt::print(" {:.4g} |", value->mean);
      }
    }
    fmt::print("\n");
  }
}

/// A chart a column: each group's mean over the time, and its runs as dots.
std::string plot(const std::vector<Group>& groups) {
  constexpr std::array<const char*, 6> kColours = {"#1f77b4", "#d62728", "#2ca02c",
                                                   "#9467bd", "#ff7f0e", "#8c564b"};
  constexpr std::array<Metric, 5> kShown = {Metric::kAngularDegrees, Metric::kDepthAligned, Metric::kSigmaT,
                                            Metric::kAlbedo, Metric::kG};
  constexpr std::array<const char*, 5> kTitles = {"normals, degrees", "depth, aligned", "sigma_t", "albedo",
                                                  "g"};
  constexpr int kWidth = 430, kHeight = 280;
  std::vector<std::string> charts;
  for (size_t k = 0; k < kShown.size(); ++k) {
    const auto metric = static_cast<size_t>(kShown[k]);
    std::vector<ChartSeries> series;
    for (size_t i = 0; i < groups.size(); ++i) {
      const std::vector<double> seconds = times(groups[i]);
      ChartSeries mean{.name = groups[i].name, .colour = kColours[i % kColours.size()], .points = {}};
      ChartSeries dots{.name = "", .colour = mean.colour, .points = {}, .markers = true, .line = false};
      for (size_t e = 0; e < seconds.size(); ++e) {
        const auto value = spread(groups[i], e, metric);
        if (!value) continue;
        mean.points.push_back({seconds[e], value->mean});
        for (const Run& run : groups[i].runs) {
          dots.points.push_back({seconds[e], *run.evaluations[e].metrics[metric]});
        }
      }
      series.push_back(std::move(mean));
      series.push_back(std::move(dots));
    }
    charts.push_back(render_chart(
        series, {.title = kTitles[k], .x_label = "seconds of training", .width = kWidth, .height = kHeight}));
  }
  return chart_sheet(charts, 2, kWidth, kHeight);
}

nlohmann::ordered_json to_json(const std::vector<Group>& groups) {
  nlohmann::ordered_json json = nlohmann::ordered_json::array();
  for (const Group& group : groups) {
    const std::vector<double> seconds = times(group);
    nlohmann::ordered_json evaluations = nlohmann::ordered_json::array();
    for (size_t e = 0; e < seconds.size(); ++e) {
      const Evaluation& at = group.runs.front().evaluations[e];
      nlohmann::ordered_json row = {{"stage", at.stage}, {"epoch", at.epoch}, {"seconds", seconds[e]}};
      for (size_t m = 0; m < kMetricCount; ++m) {
        const auto value = spread(group, e, m);
        if (!value) continue;
        row[std::string(kMetricNames[m])] = {{"mean", value->mean}};
        if (value->deviation) row[std::string(kMetricNames[m])]["deviation"] = *value->deviation;
      }
      evaluations.push_back(std::move(row));
    }
    json.push_back({{"config", group.name}, {"runs", group.runs.size()}, {"evaluations", evaluations}});
  }
  return json;
}

void run_bench_runs(const RunsArguments& arguments) {
  std::vector<Group> groups = read_groups(arguments.runs);
  if (!arguments.names.empty() && arguments.names.size() != groups.size()) {
    fail_usage("bench runs", "--names gives {} names, there are {} groups", arguments.names.size(),
               groups.size());
  }
  for (size_t i = 0; i < arguments.names.size(); ++i) groups[i].name = arguments.names[i];
  if (!arguments.plot.empty()) write_file_atomically(arguments.plot, std::string_view(plot(groups)));
  if (arguments.json) {
    fmt::print("{}\n", to_json(groups).dump());
  } else {
    print_table(groups);
  }
}

}  // namespace

void add_bench_runs(CLI::App& bench) {
  const auto arguments = std::make_shared<RunsArguments>();
  CLI::App* command = bench.add_subcommand(
      "runs",
      "Compare training runs: errors on the test scenes over the time of training. Runs whose configs differ "
      "by the seed\nalone make a group: means and standard deviations. Time is that of epochs, by their "
      "median "
      "in the group; evaluations\nand checkpoints do not count.");
  command
      ->add_option("runs", arguments->runs, "Run folders; groups are named by how they differ from the first")
      ->required();
  command->add_option("--plot", arguments->plot, "Errors over time, as SVG");
  command->add_flag("--json", arguments->json, "Print every evaluation as JSON");
  command->callback([arguments] { run_bench_runs(*arguments); });
}

}  // namespace opaline::cli
