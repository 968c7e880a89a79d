#include "data/render/stress.h"

#include <catch2/catch.hpp>
#include <cmath>

#include "data/render/guide.h"
#include "data/render/solids.h"

using namespace opaline;
using namespace opaline::render;

namespace {

constexpr int64_t kPaths = 40'000;

const StressCase& named(const std::vector<StressCase>& cases, const std::string& name) {
  for (const StressCase& stress : cases)
    if (stress.name == name) return stress;
  FAIL("no case is called " << name);
  return cases.front();
}

void require_passes(const StressCase& stress, const StressResult& r) {
  INFO(stress.name << ": S0 " << r.s0[0].mean << " " << r.s0[1].mean << " " << r.s0[2].mean << ", clear "
                   << r.clear.mean << ", lost " << r.faults.lost << " of " << r.faults.paths);
  CHECK(r.not_finite == 0);
  CHECK(r.lost_per_million() <= stress.lost_per_million);
  CHECK(r.passes(stress.lost_per_million));
  for (size_t c = 0; c < 3; ++c) {
    if (r.conservative[c]) CHECK(r.s0[c].standard_error <= 0.003);
  }
  CHECK(r.clear.standard_error <= 0.003);
}

}  // namespace

TEST_CASE("extreme shapes and media neither lose nor make light", "[statistics]") {
  for (const StressCase& stress : stress_cases()) {
    require_passes(stress, run_stress(stress, {.paths = kPaths, .seed = 1}));
  }
}

TEST_CASE("a scene a thousand times as small or as large looks the same", "[statistics]") {
  const std::vector<StressCase> cases = stress_cases();
  for (const char* name :
       {"ball, 10 per metre", "shell (concave), 1000 per metre", "cubes that share a face, clear",
        "small cube on a large one, 10 per metre", "sigma_t = 1e4, albedo 0.999"}) {
    const StressCase& stress = named(cases, name);
    const StressResult one = run_stress(stress, {.paths = kPaths, .seed = 2});
    for (const double factor : {1e-3, 1e3}) {
      const StressCase other = scaled(stress, factor);
      const StressResult r = run_stress(other, {.paths = kPaths, .seed = 2});
      require_passes(other, r);
      for (size_t c = 0; c < 3; ++c) {
        const double error = std::hypot(one.s0[c].standard_error, r.s0[c].standard_error);
        CHECK(std::abs(one.s0[c].mean - r.s0[c].mean) <= 4.0 * error + 1e-9);
      }
    }
  }
}

TEST_CASE("a result that is not a number does not pass") {
  const double nan = std::nan("");
  const auto result = [](double mean, double error) {
    StressResult r{.s0 = {}, .clear = {1.0, 1e-3}, .conservative = {true, true, true}, .faults = {}};
    for (Estimate& e : r.s0) e = {mean, error};
    return r;
  };
  CHECK(result(1.0, 1e-3).passes());
  CHECK_FALSE(result(nan, 1e-3).passes());
  CHECK_FALSE(result(nan, nan).passes());
  CHECK_FALSE(result(1.01, 1e-3).passes());
  StressResult r = result(0.5, 1e-3);
  CHECK_FALSE(r.passes());
  r.conservative = {false, false, false};
  CHECK(r.passes());
  r.faults = {.lost = 1, .paths = 1000};
  CHECK_FALSE(r.passes());
  CHECK(r.passes(1000.0));
  r = result(1.0, 1e-3);
  r.not_finite = 1;
  CHECK_FALSE(r.passes());
}

TEST_CASE("without light there is none, guided or not") {
  const auto geometry = make_mesh_geometry(make_shell(8, 0.8));
  const Illumination dark;
  World world{.geometry = geometry.get(),
              .light = &dark,
              .medium = {.sigma_t = {3, 3, 3}, .albedo = {1, 1, 1}, .g = 0.5}};
  const Guide guide(world, dark, {-1, -1, -1}, {1, 1, 1}, Random(1, Purpose::kTest));
  Random random(1, Purpose::kTest);
  for (const Guide* steering : {static_cast<const Guide*>(nullptr), &guide}) {
    world.guide = steering;
    PathFaults faults;
    for (int i = 0; i < 100; ++i) {
      const CameraRay ray{{random.uniform(-0.9, 0.9), 0.0, 3.0}, {0, 0, -1}, {1, 0, 0}};
      const PathSample s = sample_path(world, ray, random, faults);
      REQUIRE(s.hit);
      for (const StokesRgb* part : {&s.reflected, &s.unscattered, &s.scattered, &s.clear, &s.mirror})
        for (const Rgb& component : *part) REQUIRE(component == Rgb{});
    }
  }
}
