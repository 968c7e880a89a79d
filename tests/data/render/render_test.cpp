#include "data/render/render.h"

#include <catch2/catch.hpp>
#include <cmath>

#include "core/parallel.h"

using namespace opaline;
using namespace opaline::render;

namespace {

const Camera kCamera{.width = 20, .height = 20};

SceneModel dull_scene() {
  SceneModel scene = draw_scene({.families = {Family::kHarmonics}}, kCamera, 3, 1);
  scene.medium = {.sigma_t = {20.0, 24.0, 30.0}, .albedo = {0.6, 0.5, 0.4}, .g = 0.2};
  return scene;
}

/// Mean and its standard error over seeds of the object's mean S0 and S1.
struct Totals {
  double s0 = 0.0, s0_error = 0.0, s1 = 0.0, s1_error = 0.0, bsdf = 0.0, bsdf_error = 0.0;
};

Totals measure(const SceneModel& scene, RenderOptions options, int seeds) {
  std::array<double, 3> sum{}, square{};
  for (int seed = 0; seed < seeds; ++seed) {
    options.seed = 100 + static_cast<uint64_t>(seed);
    const SceneRender r = render_scene(scene, kCamera, options);
    std::array<double, 3> one{};
    for (size_t p = 0; p < r.coverage.size(); ++p) {
      one[0] += static_cast<double>(r.image[9 * p + 1]);
      one[1] += std::abs(static_cast<double>(r.normal[3 * p])) * static_cast<double>(r.image[9 * p + 4]);
      one[2] += static_cast<double>(r.bsdf[9 * p + 1]);
    }
    for (size_t i = 0; i < 3; ++i) {
      sum[i] += one[i];
      square[i] += one[i] * one[i];
    }
  }
  const double n = seeds;
  const auto error = [&](size_t i) {
    return std::sqrt(std::max(0.0, square[i] / n - sum[i] / n * (sum[i] / n)) / (n - 1.0));
  };
  return {sum[0] / n, error(0), sum[1] / n, error(1), sum[2] / n, error(2)};
}

bool agree(double a, double a_error, double b, double b_error) {
  return std::abs(a - b) <= 4.0 * std::hypot(a_error, b_error) + 1e-9;
}

/// Root mean square over whole pixels of the difference of two renders / root 2, relative to the mean.
double error_between(const SceneRender& a, const SceneRender& b) {
  double square = 0.0, light = 0.0;
  for (size_t p = 0; p < a.coverage.size(); ++p) {
    if (!(a.coverage[p] >= 1.0F && b.coverage[p] >= 1.0F)) continue;
    for (size_t c = 0; c < 3; ++c) {
      const double u = std::min(2.0, double{a.image[9 * p + c]}),
                   v = std::min(2.0, double{b.image[9 * p + c]});
      square += 0.5 * (u - v) * (u - v);
      light += 0.5 * (u + v);
    }
  }
  int64_t count = 0;
  for (size_t p = 0; p < a.coverage.size(); ++p)
    count += a.coverage[p] >= 1.0F && b.coverage[p] >= 1.0F ? 3 : 0;
  const auto n = static_cast<double>(count);
  return std::sqrt(square / n) / (light / n);
}

}  // namespace

TEST_CASE("samples follow the error that is asked for") {
  const SceneModel scene = dull_scene();
  for (const double wanted : {0.2, 0.1}) {
    const RenderOptions options{
        .spp = 4, .error = wanted, .dop_error = 1.0, .photons = 20'000, .seed = 1, .number = 1};
    RenderOptions other = options;
    other.seed = 2;
    const SceneRender a = render_scene(scene, kCamera, options), b = render_scene(scene, kCamera, other);
    const double reached = error_between(a, b);
    INFO("wanted " << wanted << " reached " << reached << " with " << a.spp << " paths a pixel");
    CHECK(reached < 1.8 * wanted);
    CHECK(reached > 0.4 * wanted);
    CHECK(a.capped == 0);
  }
}

TEST_CASE("no saving changes the light", "[statistics]") {
  const SceneModel scene = dull_scene();
  const RenderOptions base{.spp = 8, .error = 0.3, .dop_error = 1.0, .photons = 20'000};
  RenderOptions plain = base;
  plain.error = 0.0;
  plain.spp = 64;
  const Totals expected = measure(scene, plain, 24);
  CHECK(expected.s0_error < 0.01 * expected.s0);
  const auto check = [&](const char* name, const Savings& savings) {
    RenderOptions options = base;
    options.savings = savings;
    const Totals light = measure(scene, options, 24);
    INFO(name << ": S0 " << light.s0 << " +- " << light.s0_error << " and " << expected.s0 << " +- "
              << expected.s0_error << ", S1 " << light.s1 << " and " << expected.s1 << ", bsdf " << light.bsdf
              << " and " << expected.bsdf);
    CHECK(agree(light.s0, light.s0_error, expected.s0, expected.s0_error));
    CHECK(agree(light.s1, light.s1_error, expected.s1, expected.s1_error));
    CHECK(agree(light.bsdf, light.bsdf_error, expected.bsdf, expected.bsdf_error));
  };
  check("all savings", {});
  check("no background", {.background = false});
  check("separate paths", {.shared_paths = false});
  check("parts alike", {.parts = false});
  check("pixels alike", {.pixels = false});
  check("no guide", {.guide = false});
  check("no light paths", {.light_paths = false});
  check("unbounded queries", {.bounded_queries = false});
  check("independent samples", {.even_samples = false});
}

TEST_CASE("an adaptive render is the same to the bit for any number of threads") {
  const SceneModel scene = dull_scene();
  const RenderOptions options{
      .spp = 2, .error = 0.4, .dop_error = 1.0, .photons = 4'000, .seed = 5, .number = 2};
  set_num_threads(1);
  const SceneRender one = render_scene(scene, kCamera, options);
  set_num_threads(3);
  const SceneRender three = render_scene(scene, kCamera, options);
  set_num_threads(0);
  CHECK(one.image == three.image);
  CHECK(one.bsdf == three.bsdf);
  CHECK(one.spp == three.spp);
}

TEST_CASE("light from everywhere needs no guide, a flash does") {
  SceneModel scene = dull_scene();
  const RenderOptions options{.spp = 1, .photons = 20'000};
  CHECK(render_scene(scene, kCamera, options).guided);
  scene.light.flash.radiance = 0.0;
  scene.light.environment = Environment(Rgb{1.0, 1.0, 1.0});
  CHECK_FALSE(render_scene(scene, kCamera, options).guided);
  RenderOptions always = options;
  always.savings.guide_by_need = false;
  CHECK(render_scene(scene, kCamera, always).guided);
}

TEST_CASE(
    "white furnace: with light from its source and from the camera a body that absorbs nothing vanishes",
    "[statistics]") {
  for (const Family family : {Family::kHarmonics, Family::kVessel}) {
    SceneModel scene = draw_scene({.families = {family}}, kCamera, 3, 2);
    scene.light.flash.radiance = 0.0;
    scene.light.environment = Environment(Rgb{1.0, 1.0, 1.0});
    scene.medium = {.sigma_t = {4.0, 7.0, 10.0}, .albedo = {1.0, 1.0, 1.0}, .g = 0.4};
    std::array<double, 3> sum{}, square{};
    constexpr int kSeeds = 72;
    for (int seed = 0; seed < kSeeds; ++seed) {
      const SceneRender r = render_scene(scene, kCamera,
                                         {.spp = 24,
                                          .photons = 20'000,
                                          .savings = {.guide_by_need = false},
                                          .seed = static_cast<uint64_t>(seed)});
      REQUIRE(r.light_paths > 0);
      std::array<double, 3> light{};
      double pixels = 0.0;
      for (size_t p = 0; p < r.coverage.size(); ++p) {
        if (!(r.coverage[p] > 0.0F)) continue;
        for (size_t c = 0; c < 3; ++c) light[c] += double{r.image[9 * p + c]};
        pixels += 1.0;
      }
      for (size_t c = 0; c < 3; ++c) {
        sum[c] += light[c] / pixels;
        square[c] += light[c] / pixels * (light[c] / pixels);
      }
    }
    for (size_t c = 0; c < 3; ++c) {
      const double mean = sum[c] / kSeeds;
      const double error = std::sqrt((square[c] / kSeeds - mean * mean) / (kSeeds - 1.0));
      INFO(scene.object << ", colour " << c << ": " << mean << " +- " << error);
      CHECK(std::abs(mean - 1.0) <= 3.0 * error);
      CHECK(error <= 3e-3);
    }
  }
}
