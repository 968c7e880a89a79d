#include "data/render/light_paths.h"

#include <catch2/catch.hpp>
#include <cmath>

#include "core/parallel.h"
#include "data/render/path.h"
#include "data/render/scene.h"

using namespace opaline;
using namespace opaline::render;

namespace {

const Camera kCamera{.width = 12, .height = 12};

/// S0, S1, S2 of scattered light summed over the image with weights that keep polarisation from cancelling.
using Totals = std::array<std::array<double, 3>, 3>;

/// +1 and -1 in the quadrants of the image, where the surface faces different ways.
double sign(size_t component, size_t pixel) {
  const bool left = pixel % 12 < 6, top = pixel / 12 < 6;
  if (component == 0) return 1.0;
  return component == 1 ? ((left == top) ? 1.0 : -1.0) : (left ? 1.0 : -1.0);
}

struct Estimate {
  Totals mean{}, error{};
};

template <class F>
Estimate over_batches(int batches, const F& run) {
  Estimate e;
  for (int b = 0; b < batches; ++b) {
    const Totals t = run(b);
    for (size_t i = 0; i < 3; ++i) {
      for (size_t c = 0; c < 3; ++c) {
        e.mean[i][c] += t[i][c] / batches;
        e.error[i][c] += t[i][c] * t[i][c] / batches;
      }
    }
  }
  for (size_t i = 0; i < 3; ++i)
    for (size_t c = 0; c < 3; ++c)
      e.error[i][c] = std::sqrt(std::max(0.0, e.error[i][c] - e.mean[i][c] * e.mean[i][c]) / (batches - 1.0));
  return e;
}

Totals by_camera(const World& world, bool direct, int batch, int samples) {
  Totals totals{};
  PathFaults faults;
  for (size_t p = 0; p < 144; ++p) {
    Random random(7, Purpose::kTest, static_cast<uint32_t>(p), static_cast<uint32_t>(batch));
    for (int s = 0; s < samples; ++s) {
      const FirstNumbers first(random);
      const PathSample sample =
          sample_path_parts(world,
                            kCamera.ray(static_cast<double>(p % 12) + random.uniform(),
                                        static_cast<double>(p / 12) + random.uniform()),
                            {.mirror = false, .unscattered = false, .scattered = true, .direct = direct},
                            first, random, faults);
      for (size_t i = 0; i < 3; ++i)
        for (size_t c = 0; c < 3; ++c) totals[i][c] += sign(i, p) * sample.scattered[i][c] / samples;
    }
  }
  return totals;
}

Totals by_light(const LightTracer& tracer, double faint, int batch, int64_t paths) {
  Totals totals{};
  PathFaults faults;
  tracer.trace(
      {.paths = paths, .faint = faint, .seed = static_cast<uint64_t>(batch)},
      [&](std::span<const Splat> splats) {
        for (const Splat& splat : splats)
          for (size_t i = 0; i < 3; ++i)
            for (size_t c = 0; c < 3; ++c)
              totals[i][c] += sign(i, splat.pixel) * double{splat.rows[i]} * double{splat.light[c]} /
                              static_cast<double>(paths);
      },
      faults);
  CHECK(faults.lost <= faults.paths / 1000);
  return totals;
}

}  // namespace

TEST_CASE("light from its source brings the camera what the camera finds by itself", "[statistics]") {
  struct Case {
    const char* name;
    Family family;
    Medium medium;
    bool flash;
  };
  const Case cases[] = {
      {"flash, dense", Family::kHarmonics, {{20.0, 30.0, 40.0}, {0.9, 0.7, 0.4}, 0.3}, true},
      {"flash, thin and forward", Family::kHarmonics, {{3.0, 8.0, 20.0}, {0.8, 0.8, 0.8}, 0.7}, true},
      {"environment, hollow", Family::kVessel, {{5.0, 10.0, 15.0}, {0.95, 0.6, 0.3}, -0.3}, false},
      {"both, a sheet", Family::kSheet, {{10.0, 20.0, 30.0}, {0.9, 0.9, 0.9}, 0.5}, true},
  };
  for (const Case& c : cases) {
    SceneModel scene = draw_scene({.families = {c.family},
                                   .environment = {0.3, 0.3},
                                   .room = {.contrast = {100.0, 100.0}, .lamp = {20.0, 20.0}}},
                                  kCamera, 3, 2);
    scene.medium = c.medium;
    if (!c.flash) scene.light.flash.radiance = 0.0;
    World world = scene.world();
    const Guide guide(world, scene.light, scene.low, scene.high, Random(1, Purpose::kTest),
                      {.photons = 50'000});
    world.guide = &guide;
    const LightTracer tracer(world, scene.light, kCamera, scene.low, scene.high);
    REQUIRE(tracer.possible());
    const Estimate whole = over_batches(16, [&](int b) { return by_camera(world, true, b, 150); });
    const Estimate rest = over_batches(16, [&](int b) { return by_camera(world, false, 100 + b, 100); });
    // All of it, and with what is faint left to chance.
    for (const double faint : {0.0, 2.0}) {
      const Estimate light = over_batches(16, [&](int b) { return by_light(tracer, faint, b, 20'000); });
      for (size_t i = 0; i < 3; ++i) {
        for (size_t k = 0; k < 3; ++k) {
          const double sum = light.mean[i][k] + rest.mean[i][k], expected = whole.mean[i][k];
          const double error =
              std::sqrt(light.error[i][k] * light.error[i][k] + rest.error[i][k] * rest.error[i][k] +
                        whole.error[i][k] * whole.error[i][k]);
          INFO(c.name << ", S" << i << " of colour " << k << ", faint " << faint << ": " << light.mean[i][k]
                      << " + " << rest.mean[i][k] << " = " << sum << ", camera " << expected << " +- "
                      << error);
          CHECK(std::abs(sum - expected) <= 4.0 * error);
          if (i == 0) {
            CHECK(error <= 0.04 * expected);
            CHECK(light.mean[i][k] > 10.0 * error);
          }
        }
      }
    }
  }
}

TEST_CASE("light paths come in the same order for any number of threads") {
  const SceneModel scene = draw_scene({}, kCamera, 5, 1);
  const World world = scene.world();
  const LightTracer tracer(world, scene.light, kCamera, scene.low, scene.high);
  const auto run = [&](int threads) {
    set_num_threads(threads);
    std::vector<uint32_t> pixels;
    std::vector<float> light;
    PathFaults faults;
    tracer.trace(
        {.paths = 40'000, .faint = 1e-3, .seed = 3},
        [&](std::span<const Splat> splats) {
          for (const Splat& splat : splats) {
            pixels.push_back(splat.pixel);
            light.insert(light.end(), splat.light.begin(), splat.light.end());
          }
        },
        faults);
    set_num_threads(0);
    return std::pair(pixels, light);
  };
  const auto one = run(1), three = run(3);
  CHECK(one.first.size() > 1000);
  CHECK(one == three);
}
