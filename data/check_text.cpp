// The findings for a terminal and as JSON.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "data/check_parts.h"

namespace opaline {
namespace {

using Json = nlohmann::ordered_json;

constexpr size_t kBins = 16;

/// A block a bin, of eight heights.
std::string sparkline(const std::vector<int64_t>& counts) {
  constexpr std::array<std::string_view, 9> kBlocks = {" ", "▁", "▂", "▃", "▄", "▅", "▆", "▇", "█"};
  const int64_t most = std::max<int64_t>(1, *std::max_element(counts.begin(), counts.end()));
  std::string line;
  for (const int64_t count : counts) line += kBlocks[static_cast<size_t>((8 * count + most - 1) / most)];
  return line;
}

std::string split_text(const SplitCheck& split) {
  const auto read = std::count_if(split.scenes.begin(), split.scenes.end(),
                                  [](const SceneCheck& scene) { return scene.read; });
  std::string text =
      fmt::format("\n{}: {} scenes, {} usable\n", to_string(split.split), split.scenes.size(), read);
  if (read == 0) return text;
  text += fmt::format("  {:<24} {:>10} {:>10} {:>10}\n", "", "min", "mean", "max");
  const auto line = [&](std::string_view name, const Spread& s, const std::string& bars) {
    text += fmt::format("  {:<24} {:>10.4g} {:>10.4g} {:>10.4g}{}\n", name, s.min, s.mean, s.max, bars);
  };
  for (const Statistic& statistic : statistics()) {
    const Spread s = spread(split, statistic.value);
    if (s.count > 0) line(statistic.name, s, "");
  }
  for (size_t i = 0; i < parameter_ranges().size(); ++i) {
    const ParameterRange& range = parameter_ranges()[i];
    const Spread s = spread(split, parameter_value(i));
    if (s.count == 0) continue;
    line(range.name, s,
         fmt::format("   {:>4} |{}| {}", range.min, sparkline(histogram(split, i, kBins)), range.max));
  }
  return text;
}

std::string scene_lines(const DatasetCheck& check, size_t most) {
  std::string text;
  size_t shown = 0;
  const auto line = [&](std::string_view kind, const SplitCheck& split, const SceneCheck& scene,
                        const std::string& what) {
    if (shown++ < most)
      text += fmt::format("{}: {} scene {}: {}\n", kind, to_string(split.split), scene.id, what);
  };
  for (const SplitCheck& split : check.splits) {
    for (const SceneCheck& scene : split.scenes) {
      for (const std::string& problem : scene.problems) line("problem", split, scene, problem);
    }
  }
  for (const SplitCheck& split : check.splits) {
    for (const SceneCheck& scene : split.scenes) {
      for (const std::string& warning : scene.warnings) line("warning", split, scene, warning);
    }
  }
  if (shown > most) text += fmt::format("({} more not shown)\n", shown - most);
  return text;
}

Json to_json(const SceneCheck& scene) {
  Json json = {{"id", scene.id}, {"problems", scene.problems}, {"warnings", scene.warnings}};
  if (!scene.read) return json;
  json["coverage"] = scene.coverage;
  json["mean_light"] = scene.mean_light;
  json["over_white"] = scene.clipped;
  json["mean_dop"] = scene.mean_dop;
  json["dop_over_1"] = scene.over_polarised;
  json["identity"] = scene.identity;
  if (scene.pairs) {
    json["pair_ratio"] = scene.pairs->ratio;
    json["pair_rms"] = scene.pairs->rms;
    json["saturated"] = scene.pairs->saturated;
  }
  if (!scene.parameters.empty()) json["parameters"] = scene.parameters;
  return json;
}

}  // namespace

Spread spread(const SplitCheck& split, const std::function<std::optional<double>(const SceneCheck&)>& value) {
  Spread result{.min = HUGE_VAL, .mean = 0, .max = -HUGE_VAL, .count = 0};
  for (const SceneCheck& scene : split.scenes) {
    const std::optional<double> x = scene.read ? value(scene) : std::nullopt;
    if (!x) continue;
    result.min = std::min(result.min, *x);
    result.max = std::max(result.max, *x);
    result.mean += *x;
    ++result.count;
  }
  if (result.count > 0) result.mean /= static_cast<double>(result.count);
  return result;
}

const std::vector<Statistic>& statistics() {
  using Value = std::optional<double>;
  static const std::vector<Statistic> list = {
      {"coverage", [](const SceneCheck& s) { return Value(s.coverage); }},
      {"light on the object", [](const SceneCheck& s) { return Value(s.mean_light); }},
      {"share over white", [](const SceneCheck& s) { return s.pairs ? Value() : Value(s.clipped); }},
      {"share saturated", [](const SceneCheck& s) { return s.pairs ? Value(s.pairs->saturated) : Value(); }},
      {"DoP on the object", [](const SceneCheck& s) { return Value(s.mean_dop); }},
      {"share of DoP over 1", [](const SceneCheck& s) { return Value(s.over_polarised); }},
      {"(I45+I135) / (I0+I90)",
       [](const SceneCheck& s) { return s.pairs ? Value(s.pairs->ratio) : Value(); }},
      {"RMS of its difference", [](const SceneCheck& s) { return s.pairs ? Value(s.pairs->rms) : Value(); }}};
  return list;
}

std::function<std::optional<double>(const SceneCheck&)> parameter_value(size_t parameter) {
  return [parameter](const SceneCheck& scene) {
    return scene.parameters.empty() ? std::nullopt : std::optional(scene.parameters[parameter]);
  };
}

std::vector<int64_t> histogram(const SplitCheck& split, size_t parameter, size_t bins) {
  const ParameterRange& range = parameter_ranges()[parameter];
  std::vector<int64_t> counts(bins, 0);
  for (const SceneCheck& scene : split.scenes) {
    if (!scene.read || scene.parameters.empty()) continue;
    const double part = (scene.parameters[parameter] - range.min) / (range.max - range.min);
    if (!(part >= 0 && part <= 1)) continue;
    ++counts[std::min(bins - 1, static_cast<size_t>(part * static_cast<double>(bins)))];
  }
  return counts;
}

std::string to_text(const DatasetCheck& check, size_t max_problems) {
  std::string text = fmt::format("{}: {} layout", check.facts.root.string(), check.facts.layout);
  if (check.facts.width > 0) text += fmt::format(", {} x {} pixels", check.facts.width, check.facts.height);
  text += "\n\n";
  for (const Finding& finding : check.findings) {
    text += fmt::format("  {:<10} {:<27} {}\n", to_string(finding.verdict), finding.what, finding.found);
  }
  for (const SplitCheck& split : check.splits) text += split_text(split);
  text += "\n";
  for (const std::string& problem : check.problems) text += fmt::format("problem: {}\n", problem);
  for (const std::string& warning : check.warnings) text += fmt::format("warning: {}\n", warning);
  text += scene_lines(check, max_problems);
  return text + fmt::format("{} problems, {} warnings\n", check.problem_count(), check.warning_count());
}

std::string to_json(const DatasetCheck& check) {
  Json json = {
      {"root", check.facts.root.string()}, {"layout", check.facts.layout}, {"width", check.facts.width},
      {"height", check.facts.height},      {"sound", check.sound()},       {"problems", check.problems},
      {"warnings", check.warnings},        {"findings", Json::array()},    {"splits", Json::object()}};
  for (const Finding& f : check.findings) {
    json["findings"].push_back(
        {{"what", f.what}, {"expected", f.expected}, {"found", f.found}, {"verdict", to_string(f.verdict)}});
  }
  for (const SplitCheck& split : check.splits) {
    Json& scenes = json["splits"][std::string(to_string(split.split))] = Json::array();
    for (const SceneCheck& scene : split.scenes) scenes.push_back(to_json(scene));
  }
  return json.dump(1, ' ', false, Json::error_handler_t::replace) + "\n";
}

}  // namespace opaline
