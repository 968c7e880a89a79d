#include "data/render/plan.h"

#include <algorithm>
#include <cmath>

namespace opaline::render {
namespace {

/// How far a pixel's own variance is believed, beside the mean over the object. The mirror image is sharp,
/// and a few samples show where; much of the others' variance is in rare bright samples, which few pilots
/// have seen.
constexpr std::array<double, kPixelParts> kBelief = {0.9, 0.75, 0.75};

using Variances = std::array<double, kPixelParts>;

/// Variances in units of the wanted errors, so that a sum of variance / count of 1 over the object's mean
/// pixel is what is asked for.
struct Units {
  double s0, dop;

  Units(double light, const PlanOptions& options)
      : s0(1.0 / std::max(options.error * light * options.error * light, 1e-300)),
        dop(options.dop_error > 0.0 ? 1.0 / (options.dop_error * options.dop_error) : 0.0) {}

  double operator()(double s0_variance, double dop_variance) const {
    return std::max(s0_variance * s0, dop_variance * dop);
  }
};

}  // namespace

SamplePlan plan_samples(const std::vector<PixelPilot>& pilots, int width, int height,
                        const PlanOptions& options) {
  double light = 0.0, objects = 0.0;
  for (const PixelPilot& pilot : pilots) {
    if (!pilot.whole) continue;
    light += pilot.light;
    objects += 1.0;
  }
  SamplePlan plan{.pixels = std::vector<PartCounts>(pilots.size(), PartCounts{})};
  std::vector<PartCounts>& counts = plan.pixels;
  if (!(light > 0.0)) {
    for (size_t i = 0; i < pilots.size(); ++i)
      if (pilots[i].object) counts[i] = options.least;
    return plan;
  }
  light /= objects;

  const auto at = [width](int x, int y) {
    return static_cast<size_t>(y) * static_cast<size_t>(width) + static_cast<size_t>(x);
  };
  std::vector<Variances> own(pilots.size()), smooth(pilots.size());
  const Units units(light, options);
  double light_path = 0.0;
  for (size_t i = 0; i < pilots.size(); ++i) {
    for (size_t p = 0; p < kPixelParts; ++p) own[i][p] = units(pilots[i].s0[p], pilots[i].dop[p]);
    light_path += units(pilots[i].light_path_s0, pilots[i].light_path_dop);
  }
  Variances mean{};
  double touched = 0.0;
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      if (!pilots[at(x, y)].object) continue;
      double weight = 0.0;
      Variances& v = smooth[at(x, y)];
      for (int j = std::max(y - 1, 0); j <= std::min(y + 1, height - 1); ++j) {
        for (int i = std::max(x - 1, 0); i <= std::min(x + 1, width - 1); ++i) {
          if (!pilots[at(i, j)].object) continue;
          for (size_t p = 0; p < kPixelParts; ++p) v[p] += own[at(i, j)][p];
          weight += 1.0;
        }
      }
      for (size_t p = 0; p < kPixelParts; ++p) mean[p] += v[p] /= weight;
      touched += 1.0;
    }
  }
  for (double& m : mean) m /= touched;
  light_path /= touched;
  const double light_path_cost = options.light_path_cost / touched;  // each pixel's share

  // Lagrange: counts = root(variance / cost) x mean over pixels of the sum over parts, light paths included,
  // of root(variance x cost).
  double budget = 0.0;
  for (size_t i = 0; i < pilots.size(); ++i) {
    if (!pilots[i].object) continue;
    double variance = 0.0, cost = 0.0, rooted = 0.0;
    for (size_t p = 0; p < kPixelParts; ++p) {
      double& v = smooth[i][p];
      v = options.pixels ? kBelief[p] * v + (1.0 - kBelief[p]) * mean[p] : mean[p];
      variance += v;
      cost += options.cost[p];
      rooted += std::sqrt(v * options.cost[p]);
    }
    budget += options.parts ? rooted : std::sqrt(variance * cost);
  }
  budget = budget / touched + std::sqrt(light_path * light_path_cost);
  for (size_t i = 0; i < pilots.size(); ++i) {
    if (!pilots[i].object) continue;
    double variance = 0.0, cost = 0.0;
    for (size_t p = 0; p < kPixelParts; ++p) {
      variance += smooth[i][p];
      cost += options.cost[p];
    }
    for (size_t p = 0; p < kPixelParts; ++p) {
      const double wanted =
          budget * (options.parts ? std::sqrt(smooth[i][p] / options.cost[p]) : std::sqrt(variance / cost));
      const double bounded = std::clamp(std::ceil(wanted), static_cast<double>(options.least[p]),
                                        static_cast<double>(options.most));
      counts[i][p] = static_cast<int64_t>(bounded);
    }
  }
  plan.light_paths = static_cast<int64_t>(std::ceil(budget * std::sqrt(light_path / light_path_cost)));
  return plan;
}

}  // namespace opaline::render
