#include "data/check.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <mutex>
#include <numeric>

#include "core/error.h"
#include "core/file.h"
#include "core/parallel.h"
#include "data/check_parts.h"

namespace opaline {
namespace {

constexpr double kMostMismatch = 0.05;  // of the pairs of four stored images
constexpr double kSlack = 1e-5;         // of float32 against the decimal limits of parameters

bool is_ours(const Dataset& dataset) {
  return dataset.facts().layout == "opaline";
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
      over += length > s0 * (1 + 2e-3) + 2e-7 ? 1 : 0;  // half floats round
      const float pairs =
          (s[c] + s[3 + c]) / 2 + (s[c] - s[3 + c]) / 2 - (s[c] + s[6 + c]) / 2 - (s[c] - s[6 + c]) / 2;
      if (s0 > 0) check.identity = std::max(check.identity, std::abs(static_cast<double>(pairs)) / s0);
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
  const int w = scene.width;
  const int h = scene.height;
  int64_t count = 0;
  bool border = false;
  Window box{w, h, 0, 0};
  for (int y = 0; y < h; ++y) {
    for (int x = 0; x < w; ++x) {
      if (scene.mask[static_cast<size_t>(y) * static_cast<size_t>(w) + static_cast<size_t>(x)] == 0) continue;
      ++count;
      box = {std::min(box.x0, x), std::min(box.y0, y), std::max(box.x1, x + 1), std::max(box.y1, y + 1)};
      border = border || x == 0 || y == 0 || x == w - 1 || y == h - 1;
    }
  }
  check.coverage = static_cast<double>(count) / static_cast<double>(scene.pixels());
  if (count > 0) check.box = box;
  if (count == 0) check.warnings.emplace_back("the mask is empty");
  if (border) check.warnings.emplace_back("the mask touches the border");
}

void check_parameters(const Scene& scene, SceneCheck& check) {
  if (!scene.g || !scene.sigma_t || !scene.albedo || !scene.flash) return;
  check.parameters.push_back(static_cast<double>(*scene.g));
  for (const float value : *scene.sigma_t) check.parameters.push_back(static_cast<double>(value));
  for (const float value : *scene.albedo) check.parameters.push_back(static_cast<double>(value));
  check.parameters.push_back(static_cast<double>(*scene.flash));
  for (size_t i = 0; i < parameter_ranges().size(); ++i) {
    const ParameterRange& range = parameter_ranges()[i];
    const double value = check.parameters[i];
    if (value >= range.min - kSlack * range.max && value <= range.max * (1 + kSlack)) continue;
    check.warnings.push_back(fmt::format("{} is {:.4g}, outside of the networks' {} to {}", range.name, value,
                                         range.min, range.max));
  }
}

/// What is impossible in light and geometry that we render.
void check_physics(const Scene& scene, SceneCheck& check) {
  constexpr double kFewOver = 1e-3;
  if (check.over_polarised > kFewOver) {
    check.problems.push_back(fmt::format(
        "{:.1f} % of the object's values have a degree of polarisation over 1", 100 * check.over_polarised));
  }
  float low = 0;
  float high = 0;
  for (size_t i = 0; i < scene.mask.size() && !scene.depth.empty(); ++i) {
    if (scene.mask[i] == 0) continue;
    low = std::min(low, scene.depth[i]);
    high = std::max(high, scene.depth[i]);
  }
  if (!(low >= -1.01F && high <= 1.01F)) {
    check.problems.push_back(fmt::format(
        "depth runs from {:.3g} to {:.3g}; the cube that objects stay in ends at -1 and 1", low, high));
  }
}

/// Cosine between a stored difference and that of two images, over the object.
double agreement(const std::vector<float>& stored, const std::vector<float>& a, const std::vector<float>& b,
                 const std::vector<uint8_t>& mask) {
  double with = 0;
  double stored2 = 0;
  double difference2 = 0;
  for (size_t i = 0; i < stored.size(); ++i) {
    if (mask[i / 3] == 0) continue;
    const double difference = static_cast<double>(a[i]) - static_cast<double>(b[i]);
    const auto value = static_cast<double>(stored[i]);
    with += difference * value;
    stored2 += value * value;
    difference2 += difference * difference;
  }
  const double scale = std::sqrt(stored2 * difference2);
  return scale > 0 ? with / scale : 0;
}

void check_stored(const StoredLight& stored, const Scene& scene, SceneCheck& check) {
  check.pairs = check_pairs(stored.polarisers, scene.mask);
  check.gamma = gamma_evidence(stored, scene.mask);
  if (!(std::abs(check.pairs->ratio - 1) <= kMostMismatch)) {
    check.problems.push_back(
        fmt::format("I45 + I135 is {:.3f} times I0 + I90 (median; RMS of the difference {:.1f} "
                    "%): over {:.0f} % they are no images of one scene",
                    check.pairs->ratio, 100 * check.pairs->rms, 100 * kMostMismatch));
  }
  const auto& images = stored.polarisers.images;
  if (!stored.stokes[1].empty() && !stored.stokes[2].empty()) {
    check.stored_signs = {agreement(stored.stokes[1], images[0], images[2], scene.mask),
                          agreement(stored.stokes[2], images[1], images[3], scene.mask)};
  }
}

/// Scenes whose light another one has as well, by content.
void check_duplicates(DatasetCheck& check) {
  constexpr size_t kMostNamed = 10;
  std::map<std::string_view, std::string> known;
  std::vector<std::string> twice;
  for (const SplitCheck& split : check.splits) {
    for (const SceneCheck& scene : split.scenes) {
      if (!scene.read) continue;
      const std::string name = fmt::format("{} scene {}", to_string(split.split), scene.id);
      const auto [first, fresh] = known.emplace(scene.light_hash, name);
      if (!fresh) twice.push_back(fmt::format("{} has the light of {}", name, first->second));
    }
  }
  for (size_t i = 0; i < std::min(twice.size(), kMostNamed); ++i) check.problems.push_back(twice[i]);
  check.findings.push_back({"each scene once", "no two with the same light",
                            twice.empty() ? "none" : fmt::format("{} scenes are there again", twice.size()),
                            twice.empty() ? Verdict::kGood : Verdict::kBad});
}

/// Scenes whose normals and depth are in another frame than the set's.
void check_odd_frames(bool ours, DatasetCheck& check) {
  if (!check.frame.known) return;
  for (SplitCheck& split : check.splits) {
    for (SceneCheck& scene : split.scenes) {
      const FrameMatch match = match_frame(scene.frame);
      if (!match.known || match.agrees(check.frame)) continue;
      const std::string text = "normals and depth are in another frame than the set's: " + to_string(match);
      (ours ? scene.problems : scene.warnings).push_back(text);
    }
  }
}

}  // namespace

const std::vector<ParameterRange>& parameter_ranges() {
  static const std::vector<ParameterRange> ranges = {
      {"g", 0, 0.9},           {"sigma_t R", 0, 32},    {"sigma_t G", 0, 32},    {"sigma_t B", 0, 32},
      {"albedo R", 0.3, 0.95}, {"albedo G", 0.3, 0.95}, {"albedo B", 0.3, 0.95}, {"flash", 35, 75}};
  return ranges;
}

std::string_view to_string(Verdict verdict) {
  switch (verdict) {
    case Verdict::kGood:
      return "good";
    case Verdict::kUndecided:
      return "undecided";
    case Verdict::kWarning:
      return "warning";
    case Verdict::kBad:
      break;
  }
  return "BAD";
}

SceneCheck check_scene(const Dataset& dataset, Split split, int64_t index) {
  SceneCheck check;
  check.id = dataset.id(split, index);
  try {
    const Scene scene = dataset.load(split, index);
    check_mask(scene, check);
    measure_light(scene, check);
    check_parameters(scene, check);
    if (is_ours(dataset)) check_physics(scene, check);
    if (!scene.normal.empty() && !scene.depth.empty()) check.frame = frame_evidence(scene);
    check.signs = sign_evidence(scene);
    check.light_hash = to_hex(xxh64(std::as_bytes(std::span(scene.image))));
    if (const auto stored = dataset.load_stored(split, index)) check_stored(*stored, scene, check);
    check.read = true;
  } catch (const std::exception& e) {
    check.problems.emplace_back(e.what());
  }
  return check;
}

DatasetCheck check_dataset(const Dataset& dataset, const CheckOptions& options) {
  DatasetCheck check;
  check.facts = dataset.facts();
  const int64_t total = dataset.size(Split::kTrain) + dataset.size(Split::kTest);
  int64_t done = 0;
  std::mutex mutex;
  options.progress(0, total);
  for (const Split split : {Split::kTrain, Split::kTest}) {
    SplitCheck found{.split = split, .scenes = {}};
    found.scenes.resize(static_cast<size_t>(dataset.size(split)));
    parallel_for(dataset.size(split), [&](int64_t i) {
      found.scenes[static_cast<size_t>(i)] = check_scene(dataset, split, i);
      const std::lock_guard lock(mutex);
      options.progress(++done, total);
    });
    if (!found.scenes.empty()) check.splits.push_back(std::move(found));
  }
  if (check.splits.empty()) check.problems.emplace_back("the set has no scenes");
  // Sums in the scenes' order, whatever thread had which.
  FrameEvidence frame;
  SignEvidence signs;
  GammaEvidence gamma;
  for (const SplitCheck& split : check.splits) {
    for (const SceneCheck& scene : split.scenes) {
      frame += scene.frame;
      signs += scene.signs;
      gamma += scene.gamma;
    }
  }
  check.frame = match_frame(frame);
  check.signs = match_signs(signs, check.frame);
  check.gamma = match_gamma(gamma);
  check_odd_frames(is_ours(dataset), check);
  add_findings(dataset, check);
  if (is_ours(dataset)) check_scene_set(dataset, check);
  check_duplicates(check);
  return check;
}

int64_t DatasetCheck::problem_count() const {
  auto count = static_cast<int64_t>(problems.size());
  for (const SplitCheck& split : splits) {
    for (const SceneCheck& scene : split.scenes) count += static_cast<int64_t>(scene.problems.size());
  }
  return count;
}

int64_t DatasetCheck::warning_count() const {
  auto count = static_cast<int64_t>(warnings.size());
  for (const SplitCheck& split : splits) {
    for (const SceneCheck& scene : split.scenes) count += static_cast<int64_t>(scene.warnings.size());
  }
  return count;
}

}  // namespace opaline
