// The page's lines: each what was looked at, expected and found.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>

#include "data/check_parts.h"

namespace opaline {
namespace {

template <class F>
void for_each_read(const DatasetCheck& check, const F& f) {
  for (const SplitCheck& split : check.splits) {
    for (const SceneCheck& scene : split.scenes) {
      if (scene.read) f(scene);
    }
  }
}

/// Smallest and largest, for texts of one or several scenes.
struct Extent {
  double low = HUGE_VAL;
  double high = -HUGE_VAL;
  void add(double x) {
    low = std::min(low, x);
    high = std::max(high, x);
  }
  std::string text(int digits, double scale = 1) const {
    const std::string a = fmt::format("{:.{}f}", scale * low, digits);
    const std::string b = fmt::format("{:.{}f}", scale * high, digits);
    return a == b ? a : a + " to " + b;
  }
};

void add_files(const DatasetCheck& check, bool ours, std::vector<Finding>& findings) {
  int64_t all = 0;
  int64_t read = 0;
  for (const SplitCheck& split : check.splits) all += static_cast<int64_t>(split.scenes.size());
  for_each_read(check, [&](const SceneCheck&) { ++read; });
  findings.push_back({"files", ours ? "all read, checksums right" : "all read",
                      fmt::format("{} of {}", read, all), read == all ? Verdict::kGood : Verdict::kBad});
}

void add_identity(const DatasetCheck& check, std::vector<Finding>& findings) {
  Extent ratio;
  Extent rms;
  double identity = 0;
  bool stored = false;
  bool bad = false;
  for_each_read(check, [&](const SceneCheck& scene) {
    identity = std::max(identity, scene.identity);
    if (!scene.pairs) return;
    stored = true;
    ratio.add(scene.pairs->ratio);
    rms.add(scene.pairs->rms);
    bad = bad || !(std::abs(scene.pairs->ratio - 1) <= 0.05);
  });
  const std::string name = "I0 + I90 = I45 + I135";
  if (!stored) {
    constexpr double kRounding = 1e-6;
    findings.push_back({name, "exact", fmt::format("largest difference {:.1g} of S0", identity),
                        identity <= kRounding ? Verdict::kGood : Verdict::kBad});
    return;
  }
  findings.push_back({name, "within 5 %",
                      fmt::format("(I45 + I135) / (I0 + I90) {} (median), RMS of the difference {} %",
                                  ratio.text(4), rms.text(1, 100)),
                      bad ? Verdict::kBad : Verdict::kGood});
}

void add_pairing(DatasetCheck& check) {
  std::array<double, 3> spread{};
  for_each_read(check, [&](const SceneCheck& scene) {
    if (!scene.pairs) return;
    for (size_t k = 0; k < 3; ++k) spread[k] += scene.pairs->spread[k];
  });
  if (!(spread[0] + spread[1] + spread[2] > 0)) return;
  constexpr std::array<std::string_view, 3> kPairs = {"0 with 90, 45 with 135", "0 with 45, 90 with 135",
                                                      "0 with 135, 45 with 90"};
  const auto best = static_cast<size_t>(std::min_element(spread.begin(), spread.end()) - spread.begin());
  const double other = std::min(spread[1], spread[2]);
  const double doubt =
      best == 0 ? other / std::max(spread[0], 1e-12) : spread[0] / std::max(spread[best], 1e-12);
  constexpr double kClear = 1.2;
  const std::string found = fmt::format("{} fit best, {:.1f} times better than {}", kPairs[best], doubt,
                                        best == 0 ? "others" : "those");
  if (!(doubt > kClear)) {
    check.findings.push_back({"angles of the images", std::string(kPairs[0]),
                              "undecided: light is hardly polarised", Verdict::kUndecided});
  } else {
    judge(check, {"angles of the images", std::string(kPairs[0]), found,
                  best == 0 ? Verdict::kGood : Verdict::kBad});
  }
}

void add_stored_signs(const DatasetCheck& check, std::vector<Finding>& findings) {
  Extent first;
  Extent second;
  for_each_read(check, [&](const SceneCheck& scene) {
    if (!scene.stored_signs) return;
    first.add((*scene.stored_signs)[0]);
    second.add((*scene.stored_signs)[1]);
  });
  if (!(first.low <= first.high)) return;
  const auto text = [](const Extent& e) {
    return e.low > 0 ? std::string("+") : e.high < 0 ? std::string("-") : std::string("mixed ");
  };
  findings.push_back({"stored s1.npy, s2.npy", "either sign (converted)",
                      fmt::format("s1 = {}(p0 - p90), s2 = {}(p45 - p135); cosines {}, {}", text(first),
                                  text(second), first.text(3), second.text(3)),
                      Verdict::kGood});
}

void add_gamma(DatasetCheck& check, bool stored) {
  if (!stored) return;
  const Verdict verdict = !check.gamma.agrees()                                    ? Verdict::kBad
                          : check.gamma.known || check.gamma.by_stokes.has_value() ? Verdict::kGood
                                                                                   : Verdict::kUndecided;
  judge(check, {"gamma", fmt::format("{}", kDeclaredGamma), to_string(check.gamma), verdict});
}

void add_signs(DatasetCheck& check) {
  const Verdict verdict = !check.signs.agrees() ? Verdict::kBad
                          : check.signs.known   ? Verdict::kGood
                                                : Verdict::kUndecided;
  judge(check, {"signs of s1 and s2", "s1 = I0 - I90, s2 = I45 - I135, counter-clockwise",
                to_string(check.signs), verdict});
}

void add_frame(DatasetCheck& check, bool ours) {
  if (!(check.frame.silhouette > 0)) return;
  const Verdict verdict = check.frame.ours()   ? Verdict::kGood
                          : !check.frame.known ? Verdict::kUndecided
                          : ours               ? Verdict::kBad
                                               : Verdict::kWarning;
  judge(check, {"normals and depth", "x right, y up, z towards the camera, larger depth is nearer",
                to_string(check.frame), verdict});
}

void add_numbers(const DatasetCheck& check, std::vector<Finding>& findings) {
  Extent coverage;
  Extent saturated;
  Extent over;
  int64_t odd_masks = 0;
  int64_t odd_parameters = 0;
  bool parameters = false;
  for_each_read(check, [&](const SceneCheck& scene) {
    coverage.add(scene.coverage);
    saturated.add(scene.pairs ? scene.pairs->saturated : scene.clipped);
    over.add(scene.over_polarised);
    parameters = parameters || !scene.parameters.empty();
    for (const std::string& warning : scene.warnings) {
      (warning.find("the mask") == 0 ? odd_masks : odd_parameters) +=
          warning.find("outside of the networks'") != std::string::npos || warning.find("the mask") == 0 ? 1
                                                                                                         : 0;
    }
  });
  if (!(coverage.low <= coverage.high)) return;
  const auto tone = [](bool good) { return good ? Verdict::kGood : Verdict::kWarning; };
  findings.push_back({"mask", "not empty, off the border",
                      fmt::format("covers {} % of the image{}", coverage.text(0, 100),
                                  odd_masks > 0 ? fmt::format("; {} scenes are warned of", odd_masks) : ""),
                      tone(odd_masks == 0)});
  constexpr double kMuch = 0.25;
  findings.push_back({"saturation", "under 25 % of the object's values",
                      fmt::format("{} % of the object's values", saturated.text(1, 100)),
                      tone(saturated.high <= kMuch)});
  findings.push_back({"degree of polarisation", "at most 1",
                      fmt::format("over 1 in {} % of the object's values", over.text(2, 100)),
                      tone(over.high <= 0.01)});
  if (!parameters) return;
  findings.push_back({"parameters", "in the networks' ranges",
                      odd_parameters > 0 ? fmt::format("{} values outside", odd_parameters) : "all inside",
                      tone(odd_parameters == 0)});
}

}  // namespace

void judge(DatasetCheck& check, const Finding& finding) {
  check.findings.push_back(finding);
  const std::string text =
      fmt::format("{}: {} (expected: {})", finding.what, finding.found, finding.expected);
  if (finding.verdict == Verdict::kBad) check.problems.push_back(text);
  if (finding.verdict == Verdict::kWarning) check.warnings.push_back(text);
}

void add_findings(const Dataset& dataset, DatasetCheck& check) {
  const bool ours = dataset.facts().layout == "opaline";
  add_files(check, ours, check.findings);
  add_identity(check, check.findings);
  add_pairing(check);
  add_signs(check);
  add_stored_signs(check, check.findings);
  add_gamma(check, !ours);
  add_frame(check, ours);
  add_numbers(check, check.findings);
}

}  // namespace opaline
