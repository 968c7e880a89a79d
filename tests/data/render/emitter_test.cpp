#include "data/render/emitter.h"

#include <catch2/catch.hpp>
#include <cmath>
#include <numbers>

#include "core/random.h"
#include "data/render/sequence.h"

using namespace opaline;
using namespace opaline::render;

namespace {

constexpr double kPi = std::numbers::pi;

/// Power through a small ball, over its cross-section: the radiance's integral over the sphere there.
struct Fluence {
  double mean = 0.0, error = 0.0;
};
Fluence fluence(const Emitter& emitter, const Vec3& centre, double radius, size_t colour) {
  Random random(3, Purpose::kTest);
  constexpr int kCount = 300'000;
  double sum = 0.0, square = 0.0;
  for (int i = 0; i < kCount; ++i) {
    const LightRay ray = emitter.emit(uniform<Emitter::kDimensions>(random));
    const Vec3 way = centre - ray.origin;
    const double along = dot(way, ray.direction);
    if (!(along > 0.0 && dot(way, way) - along * along <= radius * radius)) continue;
    const double light = ray.flux[colour] / (kPi * radius * radius);
    sum += light;
    square += light * light;
  }
  const double mean = sum / kCount;
  return {mean, std::sqrt((square / kCount - mean * mean) / kCount)};
}

}  // namespace

TEST_CASE("an emitter's rays carry the light's radiance", "[statistics]") {
  // An environment with a bright texel beside dark ones, read bilinearly.
  std::vector<Rgb> texels(8 * 16, Rgb{0.1, 0.2, 0.0});
  texels[3 * 16 + 5] = {60.0, 10.0, 0.0};
  Illumination light;
  light.environment = Environment(texels, 16);
  constexpr double kRadius = 0.03;
  for (const double flash : {0.0, 40.0}) {
    light.flash.radiance = flash;
    const Emitter emitter(light, {0.01, 0.0, -0.02}, 0.25);
    CHECK(emitter.complete());
    CHECK_FALSE(emitter.dark());
    for (const Vec3& centre : {Vec3{0.01, 0.0, -0.02}, Vec3{0.2, 0.05, 0.03}, Vec3{-0.05, -0.1, -0.2}}) {
      for (const size_t colour : {0U, 1U, 2U}) {
        // Of the flash: its solid angle, about the same for all of the small ball.
        const Vec3 to_flash = light.flash.centre - centre;
        const double sine2 = light.flash.radius * light.flash.radius / dot(to_flash, to_flash);
        const double expected =
            light.environment.fluence()[colour] + flash * 2.0 * kPi * (1.0 - std::sqrt(1.0 - sine2));
        const Fluence found = fluence(emitter, centre, kRadius, colour);
        INFO("flash " << flash << " colour " << colour << ": " << found.mean << " +- " << found.error
                      << ", expected " << expected);
        CHECK(std::abs(found.mean - expected) <= 4.0 * found.error + 5e-3 * expected);
        CHECK(found.error <= 0.05 * expected);
      }
    }
  }
}

TEST_CASE("the flash hides what is behind it", "[statistics]") {
  Illumination light;
  light.environment = Environment(Rgb{1.0, 1.0, 1.0});
  light.flash.radiance = 1e-6;
  // Rays to all of the ball: without the flash each would carry the same.
  const double hidden = 4.0 * kPi - fluence(Emitter(light, {}, 0.2), {}, 0.2, 0).mean;
  const double solid_angle = 2.0 * kPi * (1.0 - std::sqrt(1.0 - 0.1 * 0.1 / (0.8 * 0.8)));
  CHECK(hidden == Approx(solid_angle).epsilon(0.1));
}

TEST_CASE("an emitter says when there is no light, and when the flash is too near") {
  Illumination light;
  CHECK(Emitter(light, {}, 0.2).dark());
  light.flash.radiance = 1.0;
  CHECK(Emitter(light, {}, 0.2).complete());
  CHECK_FALSE(Emitter(light, {}, 0.75).complete());
}
