#include "data/render/plan.h"

#include <catch2/catch.hpp>
#include <cmath>
#include <limits>

using namespace opaline::render;

namespace {

PixelPilot pilot(double light, PartCounts variances) {
  PixelPilot p{.object = true, .whole = true, .light = light};
  for (size_t i = 0; i < kPixelParts; ++i) p.s0[i] = static_cast<double>(variances[i]);
  return p;
}

/// Root mean square over pixels of the standard error of S0, relative to the mean light.
double planned_error(const std::vector<PixelPilot>& pilots, const std::vector<PartCounts>& counts) {
  double square = 0.0, light = 0.0;
  for (size_t i = 0; i < pilots.size(); ++i) {
    for (size_t p = 0; p < kPixelParts; ++p) square += pilots[i].s0[p] / static_cast<double>(counts[i][p]);
    light += pilots[i].light;
  }
  const auto n = static_cast<double>(pilots.size());
  return std::sqrt(square / n) / (light / n);
}

double planned_cost(const std::vector<PartCounts>& counts, const std::array<double, kPixelParts>& cost) {
  double sum = 0.0;
  for (const PartCounts& c : counts)
    for (size_t p = 0; p < kPixelParts; ++p) sum += static_cast<double>(c[p]) * cost[p];
  return sum;
}

/// Two halves, a noisy and a quiet one, far enough apart that smoothing leaves them alone.
std::vector<PixelPilot> halves() {
  std::vector<PixelPilot> pilots;
  for (int y = 0; y < 12; ++y)
    for (int x = 0; x < 12; ++x)
      pilots.push_back(pilot(0.5, x < 6 ? PartCounts{1, 1, 900} : PartCounts{1, 4, 9}));
  return pilots;
}

}  // namespace

TEST_CASE("a plan reaches the error that is asked for, and no less is asked of it") {
  const auto pilots = halves();
  const std::array<double, kPixelParts> cost{2.0, 14.0, 20.0};
  const PlanOptions options{
      .error = 0.5, .dop_error = 1e9, .cost = cost, .least = {1, 1, 1}, .most = 1 << 30};
  const auto counts = plan_samples(pilots, 12, 12, options).pixels;
  CHECK(planned_error(pilots, counts) == Approx(0.5).epsilon(0.1));

  // Each freedom that is taken away costs.
  PlanOptions same_pixels = options, same_parts = options, neither = options;
  same_pixels.pixels = neither.pixels = false;
  same_parts.parts = neither.parts = false;
  const double free = planned_cost(counts, cost);
  for (const PlanOptions& o : {same_pixels, same_parts, neither}) {
    const auto other = plan_samples(pilots, 12, 12, o).pixels;
    CHECK(planned_error(pilots, other) == Approx(0.5).epsilon(0.1));
    CHECK(planned_cost(other, cost) > 1.1 * free);
  }
}

TEST_CASE("pixels off the object get nothing, and bounds hold") {
  auto pilots = halves();
  pilots[0] = {};
  pilots[1].s0[2] = 1e12;
  const auto counts =
      plan_samples(pilots, 12, 12, {.error = 0.01, .dop_error = 1e9, .least = {3, 5, 7}, .most = 1000})
          .pixels;
  CHECK(counts[0] == PartCounts{});
  for (size_t i = 1; i < counts.size(); ++i) {
    CHECK(counts[i][0] >= 3);
    CHECK(counts[i][1] >= 5);
    CHECK(counts[i][2] >= 7);
    for (const int64_t c : counts[i]) CHECK(c <= 1000);
  }
}

TEST_CASE("the degree of polarisation asks for samples of its own") {
  auto pilots = halves();
  for (PixelPilot& p : pilots) p.dop = {1e-2, 0.0, 0.0};
  const PlanOptions options{.error = 1e9, .dop_error = 0.01, .least = {1, 1, 1}};
  const auto counts = plan_samples(pilots, 12, 12, options).pixels;
  for (const PartCounts& c : counts) CHECK(c[0] == Approx(100).margin(60));
}

TEST_CASE("a black object is planned too") {
  const std::vector<PixelPilot> pilots(4, pilot(0.0, {0, 0, 0}));
  const auto counts = plan_samples(pilots, 2, 2, {.least = {2, 2, 2}}).pixels;
  for (const PartCounts& c : counts) CHECK(c == PartCounts{2, 2, 2});
}

TEST_CASE("light paths get their share of the error") {
  auto pilots = halves();
  for (PixelPilot& p : pilots) p.light_path_s0 = 50.0;
  const PlanOptions options{
      .error = 0.5, .dop_error = 1e9, .light_path_cost = 2.0 * 144.0, .least = {1, 1, 1}, .most = 1 << 30};
  const SamplePlan plan = plan_samples(pilots, 12, 12, options);
  const double pixels = planned_error(pilots, plan.pixels);
  const double light = std::sqrt(50.0 / static_cast<double>(plan.light_paths)) / 0.5;
  CHECK(std::hypot(pixels, light) == Approx(0.5).epsilon(0.1));
  // Neither more nor fewer of them would be cheaper at the same error.
  const auto cost = [&](double paths) {
    const double rest = 0.25 - 50.0 / paths / 0.25;  // of the squared error, left for pixels
    return planned_cost(plan.pixels, options.cost) * pixels * pixels / rest + paths * options.light_path_cost;
  };
  const auto paths = static_cast<double>(plan.light_paths);
  CHECK(cost(paths) < cost(0.8 * paths));
  CHECK(cost(paths) < cost(1.25 * paths));
  CHECK(plan_samples(halves(), 12, 12, options).light_paths == 0);
}
