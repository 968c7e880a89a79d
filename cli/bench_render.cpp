// `opaline bench render`: run time of the renderer against its error.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <string>
#include <vector>

#include "cli/bench.h"
#include "cli/bench_error.h"
#include "cli/bench_export.h"
#include "cli/bench_scenes.h"
#include "core/error.h"
#include "core/file.h"
#include "core/parallel.h"
#include "core/progress.h"
#include "data/chart.h"

namespace opaline::cli {
namespace {

struct Arguments {
  std::vector<std::string> scenes;
  int size = 48;
  std::vector<int64_t> spp = {4, 16, 64, 256};
  std::vector<double> error = {0.4, 0.2, 0.1};
  int64_t repeats = 0;    // 0: by the samples
  int64_t reference = 0;  // samples; 0: by the settings
  uint64_t seed = 1;
  int threads = 0;
  bool quick = false;
  bool no_savings = false;
  bool json = false;
  std::filesystem::path plot;
  std::filesystem::path export_to;
};

/// The reference has this many times the samples of the largest render, in so many renders. Its variance is
/// known and subtracted; this only keeps it from drowning what is measured.
constexpr int64_t kReferenceFactor = 4;
constexpr int64_t kReferenceRenders = 16;
constexpr int64_t kLeastReference = 256;
/// Unscattered samples at least where `error` plans: the full image alone is measured here.
constexpr int64_t kPlannedSpp = 4;

/// A saving switched off.
struct SavingResult {
  std::string_view name;
  ErrorPoint off;
  std::array<double, 4> gain{};  // efficiency with it / without
};

struct SceneResult {
  const BenchScene* scene = nullptr;
  Reference reference;
  std::vector<ErrorPoint> points;
  std::vector<SavingResult> savings;
};

/// What every scene is rendered with: first the fixed counts, then the planned ones.
std::vector<Setting> settings_of(const Arguments& a) {
  std::vector<Setting> settings;
  for (const int64_t spp : a.spp) {
    const int64_t renders = a.repeats > 0 ? a.repeats : std::clamp<int64_t>(256 / spp, 4, 16);
    settings.push_back({.name = fmt::format("{}", spp), .options = {.spp = spp}, .renders = renders});
  }
  for (const double error : a.error) {
    settings.push_back({.name = fmt::format("error {}", error),
                        .options = {.spp = kPlannedSpp, .error = error},
                        .renders = a.repeats > 0 ? a.repeats : 4});
  }
  return settings;
}

/// The setting that savings are switched off in: the middle one of those that plan, else of those that do
/// not.
size_t savings_index(const Arguments& a) {
  return a.error.empty() ? a.spp.size() / 2 : a.spp.size() + a.error.size() / 2;
}

std::vector<const BenchScene*> chosen_scenes(const Arguments& a) {
  std::vector<const BenchScene*> chosen;
  for (const BenchScene& scene : bench_scenes()) {
    const bool wanted =
        a.scenes.empty() || std::find(a.scenes.begin(), a.scenes.end(), scene.name) != a.scenes.end();
    if (wanted) chosen.push_back(&scene);
  }
  return chosen;
}

SceneResult run_scene(const BenchScene& scene, const render::Camera& camera, const Arguments& a,
                      Progress& progress) {
  const render::SceneModel model = make_bench_scene(scene, camera);
  ErrorMeter meter(model, camera, a.seed, [&] { progress.advance(1, scene.name); });
  SceneResult result{.scene = &scene, .reference = {}, .points = {}, .savings = {}};
  const int64_t largest = a.spp.empty() ? kLeastReference : *std::max_element(a.spp.begin(), a.spp.end());
  result.reference =
      meter.reference(a.reference > 0 ? a.reference : kReferenceFactor * largest, kReferenceRenders);
  if (result.reference.pixels == 0) {
    fail_usage("bench render", "at --size {} the body of '{}' fills no pixel", a.size, scene.name);
  }
  for (const Setting& setting : settings_of(a))
    result.points.push_back(meter.measure(result.reference, setting));
  if (a.no_savings) return result;
  const ErrorPoint& with = result.points[savings_index(a)];
  for (const Saving& saving : savings()) {
    Setting setting = with.setting;
    saving.off(setting.options);
    SavingResult without{saving.name, meter.measure(result.reference, setting), {}};
    for (size_t i = 0; i < without.gain.size(); ++i) {
      const double off = without.off.efficiency()[i];
      without.gain[i] = off > 0.0 ? with.efficiency()[i] / off : 0.0;
    }
    result.savings.push_back(without);
  }
  return result;
}

void print_scene(const SceneResult& result) {
  fmt::print("{}: {}; {} pixels, mean S0 {:.4g}, reference of {} samples\n", result.scene->name,
             result.scene->text, result.reference.pixels, result.reference.mean_s0(), result.reference.spp);
  fmt::print("  {:>10} {:>9} {:>9} {:>9}", "", "samples", "CPU s", "wall s");
  for (const std::string_view name : kErrorNames) fmt::print("  {:>19}", fmt::format("MSE {}", name));
  for (size_t i = 0; i < 3; ++i) fmt::print("  {:>9}", fmt::format("eff. {}", kErrorNames[i]));
  fmt::print("\n");
  for (const ErrorPoint& point : result.points) {
    fmt::print("  {:>10} {:>9.1f} {:>9.4f} {:>9.4f}", point.setting.name, point.samples, point.cost.cpu,
               point.cost.wall);
    for (size_t i = 0; i < kErrorNames.size(); ++i) {
      fmt::print("  {:>19}", fmt::format("{:.3e} +- {:.0e}", point.mse[i], point.standard_error[i]));
    }
    for (size_t i = 0; i < 3; ++i) fmt::print("  {:>9.3g}", point.efficiency()[i]);
    fmt::print("\n");
  }
  fmt::print("  slope of log MSE over log CPU time (samples):");
  for (size_t i = 0; i < kErrorNames.size(); ++i) {
    fmt::print("  {} {:.2f} ({:.2f})", kErrorNames[i], error_slope(result.points, i, false),
               error_slope(result.points, i, true));
  }
  fmt::print("\n");
  for (const SavingResult& saving : result.savings) {
    fmt::print("  {} on / off at {}: efficiency", saving.name, saving.off.setting.name);
    for (size_t i = 0; i < kErrorNames.size(); ++i)
      fmt::print("  {} x{:.3g}", kErrorNames[i], saving.gain[i]);
    fmt::print("\n");
  }
  std::fflush(stdout);
}

/// Efficiency in the room of contrast 1e5 / under uniform light of the same fluence, of errors relative to
/// the mean of S0; nothing where one of the two was not measured.
std::optional<std::array<double, 4>> contrast_ratio(const std::vector<SceneResult>& results) {
  const SceneResult *contrast = nullptr, *uniform = nullptr;
  for (const SceneResult& result : results) {
    if (result.scene->name == kContrast) contrast = &result;
    if (result.scene->name == kContrastUniform) uniform = &result;
  }
  if (contrast == nullptr || uniform == nullptr) return std::nullopt;
  const double brightness = contrast->reference.mean_s0() / uniform->reference.mean_s0();
  std::array<double, 4> ratio{};
  for (size_t i = 0; i < ratio.size(); ++i) {
    const double plain = mean_efficiency(uniform->points, i);
    if (plain > 0.0) ratio[i] = brightness * brightness * mean_efficiency(contrast->points, i) / plain;
  }
  return ratio;
}

nlohmann::ordered_json to_json(const std::array<double, 4>& values) {
  return {{"S0", values[0]}, {"S1", values[1]}, {"S2", values[2]}, {"S0_clipped", values[3]}};
}

nlohmann::ordered_json to_json(const ErrorPoint& point) {
  return {{"name", point.setting.name},
          {"samples", point.samples},
          {"renders", point.setting.renders},
          {"cpu_s", point.cost.cpu},
          {"wall_s", point.cost.wall},
          {"mse", to_json(point.mse)},
          {"mse_se", to_json(point.standard_error)},
          {"efficiency", to_json(point.efficiency())}};
}

nlohmann::ordered_json to_json(const std::vector<SceneResult>& results, const Arguments& a) {
  nlohmann::ordered_json json = {
      {"size", a.size}, {"threads", num_threads()}, {"seed", a.seed}, {"scenes", nlohmann::json::array()}};
  for (const SceneResult& result : results) {
    nlohmann::ordered_json scene = {{"name", result.scene->name},
                                    {"text", result.scene->text},
                                    {"pixels", result.reference.pixels},
                                    {"mean_S0", result.reference.mean_s0()},
                                    {"reference_spp", result.reference.spp}};
    for (const ErrorPoint& point : result.points) scene["points"].push_back(to_json(point));
    std::array<double, 4> slope{}, sample_slope{}, efficiency{};
    for (size_t i = 0; i < slope.size(); ++i) {
      slope[i] = error_slope(result.points, i, false);
      sample_slope[i] = error_slope(result.points, i, true);
      efficiency[i] = mean_efficiency(result.points, i);
    }
    scene["slope_over_cpu"] = to_json(slope);
    scene["slope_over_samples"] = to_json(sample_slope);
    scene["efficiency"] = to_json(efficiency);
    for (const SavingResult& saving : result.savings) {
      scene["savings"].push_back(
          {{"name", saving.name}, {"gain", to_json(saving.gain)}, {"off", to_json(saving.off)}});
    }
    json["scenes"].push_back(scene);
  }
  if (const auto ratio = contrast_ratio(results)) json["contrast_over_uniform"] = to_json(*ratio);
  return json;
}

/// One chart a scene: MSE over CPU time, and what slope -1 looks like.
std::string plot(const std::vector<SceneResult>& results) {
  constexpr int kWidth = 396, kHeight = 240, kColumns = 2;
  constexpr std::array<const char*, 3> kColours = {"#1f5fa8", "#c2532d", "#2e8b57"};
  std::vector<std::string> charts;
  for (size_t k = 0; k < results.size(); ++k) {
    std::vector<ChartSeries> series;
    for (size_t i = 0; i < kColours.size(); ++i) {
      series.push_back(
          {.name = std::string(kErrorNames[i]), .colour = kColours[i], .points = {}, .markers = true});
      for (const ErrorPoint& point : results[k].points) {
        if (point.setting.options.error > 0.0) continue;  // another curve: it would cross this one
        series.back().points.push_back({point.cost.cpu, point.mse[i]});
      }
    }
    const ChartPoint from = series[0].points.front(), to = series[0].points.back();
    series.push_back({.name = "slope -1",
                      .colour = "#8b98a5",
                      .points = {{from.x, 2.0 * from.y}, {to.x, 2.0 * from.y * from.x / to.x}}});
    charts.push_back(render_chart(series, {.title = fmt::format("{}: MSE", results[k].scene->name),
                                           .x_label = "CPU seconds",
                                           .log_x = true,
                                           .log_y = true,
                                           .width = kWidth,
                                           .height = kHeight}));
  }
  return chart_sheet(charts, kColumns, kWidth, kHeight);
}

void run_bench_render(Arguments a, bool spp_given, bool error_given, bool size_given) {
  // Who names one kind wants that alone.
  if (error_given && !spp_given) a.spp.clear();
  if (spp_given && !error_given) a.error.clear();
  if (a.quick) {
    if (!spp_given && !error_given) a.spp = {4, 16, 64}, a.error = {0.4, 0.2};
    if (!size_given) a.size = 32;
  }
  for (const std::string& name : a.scenes) {
    const auto& all = bench_scenes();
    if (std::none_of(all.begin(), all.end(), [&](const BenchScene& s) { return s.name == name; })) {
      std::vector<std::string_view> names;
      for (const BenchScene& scene : all) names.push_back(scene.name);
      fail_usage("bench render", "no scene is called '{}'; there are {}", name, fmt::join(names, ", "));
    }
  }
  if (a.spp.empty() && a.error.empty())
    fail_usage("bench render", "neither --spp nor --error names a setting");
  std::sort(a.spp.begin(), a.spp.end());
  std::sort(a.error.rbegin(), a.error.rend());
  set_num_threads(a.threads);
  const render::Camera camera{.width = a.size, .height = a.size};
  const std::vector<const BenchScene*> scenes = chosen_scenes(a);

  const std::vector<Setting> settings = settings_of(a);
  int64_t renders = kReferenceRenders;
  for (const Setting& setting : settings) renders += setting.renders;
  if (!a.no_savings) {
    renders += static_cast<int64_t>(savings().size()) * settings[savings_index(a)].renders;
  }
  Progress progress(default_progress());
  progress.start(0, renders * static_cast<int64_t>(scenes.size()));
  std::vector<SceneResult> results;
  for (const BenchScene* scene : scenes) {
    results.push_back(run_scene(*scene, camera, a, progress));
    progress.finish();
    if (!a.json) print_scene(results.back());
    if (!a.export_to.empty() && scene->portable) {
      export_bench_scene(*scene, camera, results.back().reference, a.export_to);
    }
  }
  if (a.json) {
    fmt::print("{}\n", to_json(results, a).dump());
  } else if (const auto ratio = contrast_ratio(results)) {
    fmt::print("room of contrast 1e5 over uniform light, efficiency of errors relative to the mean of S0:");
    for (size_t i = 0; i < kErrorNames.size(); ++i) fmt::print("  {} {:.3g}", kErrorNames[i], (*ratio)[i]);
    fmt::print("\n");
  }
  if (!a.plot.empty()) write_file_atomically(a.plot, plot(results));
}

}  // namespace

void add_bench_render(CLI::App& bench) {
  const auto a = std::make_shared<Arguments>();
  CLI::App* command = bench.add_subcommand(
      "render",
      "Mean square error and efficiency 1 / (MSE x CPU time) of S0, S1 and S2 over sample counts, on fixed "
      "scenes,\nand with each saving switched off. Errors are against a reference whose own variance is "
      "subtracted.");
  command->add_option("--scenes", a->scenes, "Scenes by name (default: all)")->delimiter(',');
  command->add_option("--size", a->size, "Image size")->check(CLI::Range(8, 4096))->capture_default_str();
  CLI::Option* spp = command->add_option("--spp", a->spp, "Samples a pixel")
                         ->delimiter(',')
                         ->check(CLI::PositiveNumber)
                         ->capture_default_str();
  CLI::Option* error =
      command->add_option("--error", a->error, "Wanted errors of S0, relative to its mean (render.error)")
          ->delimiter(',')
          ->check(CLI::Range(1e-3, 10.0))
          ->capture_default_str();
  command->add_option("--repeats", a->repeats, "Renders of each count; 0: 4 to 16, more of the quick ones")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  command
      ->add_option("--reference", a->reference, "Samples of the reference; 0: four times the largest --spp")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  command->add_option("--seed", a->seed, "Seed")->capture_default_str();
  command->add_option("--threads", a->threads, "0: all cores")->check(CLI::NonNegativeNumber);
  command->add_flag("--quick", a->quick, "32 x 32 pixels, 4 to 64 samples");
  command->add_flag("--no-savings", a->no_savings, "Leave out what the savings gain");
  command->add_flag("--json", a->json, "Print one JSON object");
  command->add_option("--plot", a->plot, "Write charts of MSE over CPU time to this SVG file");
  command->add_option(
      "--export", a->export_to,
      "Write scenes that other renderers can express (mesh, parameters, reference) to this folder");
  CLI::Option* size = command->get_option("--size");
  command->callback([a, spp, error, size] {
    run_bench_render(*a, spp->count() > 0, error->count() > 0, size->count() > 0);
  });
}

}  // namespace opaline::cli
