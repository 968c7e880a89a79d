#include "data/check.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <set>

#include "core/error.h"
#include "core/parallel.h"
#include "data/scene_set.h"

namespace opaline {
namespace {

namespace fs = std::filesystem;

// Ranges that the networks' targets are mapped from (data/encode.h); outside of them a value still loads.
struct NamedRange {
  std::string_view name;
  double min;
  double max;
};
constexpr std::array<NamedRange, 8> kParameters = {{{"g", 0, 0.9},
                                                    {"sigma_t R", 0, 32},
                                                    {"sigma_t G", 0, 32},
                                                    {"sigma_t B", 0, 32},
                                                    {"albedo R", 0.3, 0.95},
                                                    {"albedo G", 0.3, 0.95},
                                                    {"albedo B", 0.3, 0.95},
                                                    {"flash", 35, 75}}};
constexpr double kSlack = 1e-5;  // of float32 against the decimal limits

struct Pixels {
  const Scene& scene;

  size_t at(int x, int y) const {
    return static_cast<size_t>(y) * static_cast<size_t>(scene.width) + static_cast<size_t>(x);
  }
  bool object(int x, int y) const {
    return x >= 0 && y >= 0 && x < scene.width && y < scene.height && scene.mask[at(x, y)] != 0;
  }
  double normal(int x, int y, size_t c) const { return static_cast<double>(scene.normal[3 * at(x, y) + c]); }
  double depth(int x, int y) const { return static_cast<double>(scene.depth[at(x, y)]); }
};

/// Where the mask ends: the direction away from it, from the pixels around.
void add_silhouette(const Pixels& pixels, int x, int y, FrameEvidence& evidence) {
  constexpr int kReach = 2;
  double out_x = 0;
  double out_y = 0;
  for (int dy = -kReach; dy <= kReach; ++dy) {
    for (int dx = -kReach; dx <= kReach; ++dx) {
      if (pixels.object(x + dx, y + dy)) continue;
      out_x += dx;
      out_y -= dy;
    }
  }
  const double out = std::hypot(out_x, out_y);
  const double nx = pixels.normal(x, y, 0);
  const double ny = pixels.normal(x, y, 1);
  const double n = std::hypot(nx, ny);
  if (!(out > 3 && n > 0.3)) return;
  evidence.outward_x += out_x * nx / (out * n);
  evidence.outward_y += out_y * ny / (out * n);
  evidence.silhouette += 1;
}

FrameEvidence frame_evidence(const Scene& scene) {
  FrameEvidence evidence;
  const Pixels pixels{scene};
  double xx = 0;
  double yy = 0;
  double nxx = 0;
  double nyy = 0;
  for (int y = 1; y < scene.height - 1; ++y) {
    for (int x = 1; x < scene.width - 1; ++x) {
      if (!pixels.object(x, y)) continue;
      const bool whole = pixels.object(x - 1, y) && pixels.object(x + 1, y) && pixels.object(x, y - 1) &&
                         pixels.object(x, y + 1);
      if (!whole) {
        add_silhouette(pixels, x, y, evidence);
        continue;
      }
      const double nz = pixels.normal(x, y, 2);
      if (!(nz > 0.3)) continue;  // steep slopes run over occlusions
      const double gx = (pixels.depth(x + 1, y) - pixels.depth(x - 1, y)) / 2;
      const double gy = (pixels.depth(x, y - 1) - pixels.depth(x, y + 1)) / 2;
      const double px = -pixels.normal(x, y, 0) / nz;
      const double py = -pixels.normal(x, y, 1) / nz;
      evidence.slope_x += gx * px;
      evidence.slope_y += gy * py;
      xx += gx * gx;
      yy += gy * gy;
      nxx += px * px;
      nyy += py * py;
    }
  }
  evidence.slope_x_scale = std::sqrt(xx * nxx);
  evidence.slope_y_scale = std::sqrt(yy * nyy);
  return evidence;
}

void add(FrameEvidence& sum, const FrameEvidence& one) {
  sum.outward_x += one.outward_x;
  sum.outward_y += one.outward_y;
  sum.silhouette += one.silhouette;
  sum.slope_x += one.slope_x;
  sum.slope_y += one.slope_y;
  sum.slope_x_scale += one.slope_x_scale;
  sum.slope_y_scale += one.slope_y_scale;
}

void measure_light(const Scene& scene, SceneCheck& check) {
  int64_t values = 0;
  int64_t clipped = 0;
  int64_t over = 0;
  for (int64_t i = 0; i < scene.pixels(); ++i) {
    if (scene.mask[static_cast<size_t>(i)] == 0) continue;
    const float* s = scene.image.data() + i * kStokesChannels;
    for (int c = 0; c < 3; ++c) {
      const auto s0 = static_cast<double>(s[c]);
      const auto s1 = static_cast<double>(s[3 + c]);
      const auto s2 = static_cast<double>(s[6 + c]);
      const double length = std::hypot(s1, s2);
      check.mean_light += s0 / 2;
      check.mean_dop += s0 > 0 ? length / s0 : 0;
      clipped += (s0 + std::max(std::abs(s1), std::abs(s2))) / 2 > 1 ? 1 : 0;
      over += length > s0 * (1 + 2e-3) ? 1 : 0;  // half floats round
      ++values;
    }
  }
  if (values == 0) return;
  const auto n = static_cast<double>(values);
  check.mean_light /= n;
  check.mean_dop /= n;
  check.clipped = static_cast<double>(clipped) / n;
  check.over_polarised = static_cast<double>(over) / n;
}

void check_mask(const Scene& scene, SceneCheck& check) {
  const Pixels pixels{scene};
  int64_t count = 0;
  bool border = false;
  for (int y = 0; y < scene.height; ++y) {
    for (int x = 0; x < scene.width; ++x) {
      if (!pixels.object(x, y)) continue;
      ++count;
      border = border || x == 0 || y == 0 || x == scene.width - 1 || y == scene.height - 1;
    }
  }
  check.coverage = static_cast<double>(count) / static_cast<double>(scene.pixels());
  if (count == 0) check.warnings.emplace_back("the mask is empty");
  if (border) check.warnings.emplace_back("the mask touches the border");
}

void check_parameters(const Scene& scene, SceneCheck& check) {
  if (!scene.g || !scene.sigma_t || !scene.albedo || !scene.flash) return;
  check.parameters.push_back(static_cast<double>(*scene.g));
  for (const float value : *scene.sigma_t) check.parameters.push_back(static_cast<double>(value));
  for (const float value : *scene.albedo) check.parameters.push_back(static_cast<double>(value));
  check.parameters.push_back(static_cast<double>(*scene.flash));
  for (size_t i = 0; i < kParameters.size(); ++i) {
    const NamedRange& range = kParameters[i];
    const double value = check.parameters[i];
    if (value >= range.min - kSlack * range.max && value <= range.max * (1 + kSlack)) continue;
    check.warnings.push_back(fmt::format("{} is {:.4g}, outside of the networks' {} to {}", range.name, value,
                                         range.min, range.max));
  }
}

/// What our own layout promises besides its scenes.
void check_scene_set(const Dataset& dataset, DatasetCheck& check) {
  const fs::path& root = check.facts.root;
  const SceneSetInfo info = read_scene_set_info(root);
  std::set<std::string> known;
  for (const Split split : {Split::kTrain, Split::kTest}) {
    const int64_t promised = split == Split::kTrain ? info.train : info.test;
    if (dataset.size(split) != promised) {
      check.problems.push_back(fmt::format("dataset.toml promises {} {} scenes, {}.jsonl lists {}", promised,
                                           to_string(split), to_string(split), dataset.size(split)));
    }
    const fs::path index = root / fmt::format("{}.jsonl", to_string(split));
    if (!fs::exists(index)) continue;
    for (const SceneRecord& record : read_scene_index(index)) {
      if (!known.insert(record.file).second) {
        check.problems.push_back(fmt::format("{} is listed more than once", record.file));
      }
    }
  }
  if (!fs::is_directory(root / "scenes")) return;
  int64_t unlisted = 0;
  for (const fs::directory_entry& entry : fs::directory_iterator(root / "scenes")) {
    unlisted += known.contains("scenes/" + entry.path().filename().string()) ? 0 : 1;
  }
  if (unlisted > 0) {
    check.warnings.push_back(fmt::format("scenes/ has {} files that no index lists", unlisted));
  }
}

struct Spread {
  double min = 0;
  double mean = 0;
  double max = 0;
};

template <class Value>
Spread spread(const std::vector<const SceneCheck*>& scenes, const Value& value) {
  Spread result{HUGE_VAL, 0, -HUGE_VAL};
  for (const SceneCheck* scene : scenes) {
    const double x = value(*scene);
    result.min = std::min(result.min, x);
    result.max = std::max(result.max, x);
    result.mean += x / static_cast<double>(scenes.size());
  }
  return result;
}

std::string split_text(const SplitCheck& split) {
  std::vector<const SceneCheck*> usable;
  for (const SceneCheck& scene : split.scenes) {
    if (scene.problem.empty()) usable.push_back(&scene);
  }
  std::string text =
      fmt::format("{}: {} scenes, {} usable\n", to_string(split.split), split.scenes.size(), usable.size());
  if (usable.empty()) return text;
  const auto line = [&](std::string_view name, const auto& value) {
    const Spread s = spread(usable, value);
    text += fmt::format("  {:<24} {:>10.4g} {:>10.4g} {:>10.4g}\n", name, s.min, s.mean, s.max);
  };
  text += fmt::format("  {:<24} {:>10} {:>10} {:>10}\n", "", "min", "mean", "max");
  line("coverage", [](const SceneCheck& s) { return s.coverage; });
  line("light on the object", [](const SceneCheck& s) { return s.mean_light; });
  line("share over white", [](const SceneCheck& s) { return s.clipped; });
  line("DoP on the object", [](const SceneCheck& s) { return s.mean_dop; });
  line("share of DoP over 1", [](const SceneCheck& s) { return s.over_polarised; });
  const bool captures = std::all_of(usable.begin(), usable.end(),
                                    [](const SceneCheck* s) { return s->pair_ratio.has_value(); });
  if (captures) {
    line("(I45+I135) / (I0+I90)", [](const SceneCheck& s) { return static_cast<double>(*s.pair_ratio); });
  }
  const bool parameters =
      std::all_of(usable.begin(), usable.end(), [](const SceneCheck* s) { return !s->parameters.empty(); });
  for (size_t i = 0; parameters && i < kParameters.size(); ++i) {
    line(kParameters[i].name, [i](const SceneCheck& s) { return s.parameters[i]; });
  }
  return text;
}

}  // namespace

FrameMatch match_frame(const FrameEvidence& e) {
  FrameMatch match;
  constexpr double kEnough = 20;
  if (e.silhouette < kEnough || !(e.slope_x_scale > 0 && e.slope_y_scale > 0)) return match;
  match.flip_x = e.outward_x < 0;
  match.flip_y = e.outward_y < 0;
  match.silhouette = (std::abs(e.outward_x) + std::abs(e.outward_y)) / e.silhouette;
  const double x = (match.flip_x ? -1 : 1) * e.slope_x / e.slope_x_scale;
  const double y = (match.flip_y ? -1 : 1) * e.slope_y / e.slope_y_scale;
  match.flip_depth = x + y < 0;
  match.slope = (match.flip_depth ? -1 : 1) * (x + y) / 2;
  match.known = match.silhouette > 0.5 && x * y > 0 && match.slope > 0.3;
  return match;
}

std::string to_string(const FrameMatch& match) {
  const std::string strength =
      fmt::format("(silhouettes {:.2f}, slopes {:.2f})", match.silhouette, match.slope);
  if (!match.known) return "undecided " + strength;
  return fmt::format("x {}, y {}, larger depth is {} {}", match.flip_x ? "left" : "right",
                     match.flip_y ? "down" : "up", match.flip_depth ? "farther" : "nearer", strength);
}

SceneCheck check_scene(const Dataset& dataset, Split split, int64_t index) {
  SceneCheck check;
  check.id = dataset.id(split, index);
  try {
    const Scene scene = dataset.load(split, index);
    check.pair_ratio = scene.pair_ratio;
    check_mask(scene, check);
    measure_light(scene, check);
    check_parameters(scene, check);
    if (!scene.normal.empty() && !scene.depth.empty()) check.frame = frame_evidence(scene);
  } catch (const std::exception& e) {
    check.problem = e.what();
  }
  return check;
}

bool DatasetCheck::sound() const {
  return problems.empty() && std::all_of(splits.begin(), splits.end(), [](const SplitCheck& split) {
           return std::all_of(split.scenes.begin(), split.scenes.end(),
                              [](const SceneCheck& scene) { return scene.problem.empty(); });
         });
}

DatasetCheck check_dataset(const Dataset& dataset) {
  DatasetCheck check;
  check.facts = dataset.facts();
  if (check.facts.layout == "opaline") check_scene_set(dataset, check);
  FrameEvidence evidence;
  for (const Split split : {Split::kTrain, Split::kTest}) {
    SplitCheck found{.split = split, .scenes = {}};
    found.scenes.resize(static_cast<size_t>(dataset.size(split)));
    parallel_for(dataset.size(split),
                 [&](int64_t i) { found.scenes[static_cast<size_t>(i)] = check_scene(dataset, split, i); });
    for (const SceneCheck& scene : found.scenes) add(evidence, scene.frame);
    if (!found.scenes.empty()) check.splits.push_back(std::move(found));
  }
  check.frame = match_frame(evidence);
  if (check.splits.empty()) check.problems.emplace_back("the set has no scenes");
  if (check.facts.layout == "opaline" && check.frame.known && !check.frame.ours()) {
    check.problems.push_back("normals and depth are not in our frame: " + to_string(check.frame));
  }
  return check;
}

std::string to_text(const DatasetCheck& check, size_t max_problems) {
  std::string text = fmt::format("{}: {} layout, {} x {} pixels\n", check.facts.root.string(),
                                 check.facts.layout, check.facts.width, check.facts.height);
  for (const SplitCheck& split : check.splits) text += split_text(split);
  if (check.frame.silhouette > 0)
    text += fmt::format("frame of normals and depth: {}\n", to_string(check.frame));
  size_t problems = check.problems.size();
  size_t warnings = check.warnings.size();
  for (const std::string& problem : check.problems) text += fmt::format("problem: {}\n", problem);
  for (const std::string& warning : check.warnings) text += fmt::format("warning: {}\n", warning);
  size_t shown = 0;
  for (const SplitCheck& split : check.splits) {
    for (const SceneCheck& scene : split.scenes) {
      warnings += scene.warnings.size();
      problems += scene.problem.empty() ? 0 : 1;
      if (!scene.problem.empty() && shown++ < max_problems) {
        text += fmt::format("problem: {} scene {}: {}\n", to_string(split.split), scene.id, scene.problem);
      }
      for (const std::string& warning : scene.warnings) {
        if (shown++ < max_problems) {
          text += fmt::format("warning: {} scene {}: {}\n", to_string(split.split), scene.id, warning);
        }
      }
    }
  }
  if (shown > max_problems) text += fmt::format("({} more not shown)\n", shown - max_problems);
  return text + fmt::format("{} problems, {} warnings\n", problems, warnings);
}

}  // namespace opaline
