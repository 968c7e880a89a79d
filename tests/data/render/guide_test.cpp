#include "data/render/guide.h"

#include <catch2/catch.hpp>
#include <cmath>
#include <numbers>

#include "data/render/render.h"
#include "data/render/solids.h"

using namespace opaline;
using namespace opaline::render;

namespace {

Vec3 uniform_direction(Random& random) {
  return around({0.0, 0.0, 1.0}, random.uniform(-1.0, 1.0), 2.0 * std::numbers::pi * random.uniform());
}

}  // namespace

TEST_CASE("a bin's directions lie in it, and its density is one over its solid angle") {
  Random random(1, Purpose::kTest);
  // The solid angles that densities stand for add up to the sphere: the mean of 1 / density over bins.
  double sphere = 0.0;
  for (int bin = 0; bin < DirectionBins::kCount; ++bin) {
    for (int i = 0; i < 4; ++i) {
      const Vec3 d = DirectionBins::direction(bin, random.uniform(), random.uniform());
      REQUIRE(norm(d) == Approx(1.0));
      const DirectionBins::Place place = DirectionBins::find(d);
      REQUIRE(place.bin == bin);
      sphere += 0.25 / place.density;
    }
  }
  CHECK(sphere == Approx(4.0 * std::numbers::pi).epsilon(2e-3));
}

TEST_CASE("what a guide samples has the density that it says", "[statistics]") {
  const SceneModel scene = draw_scene({}, {}, 4, 2);
  const Guide guide(scene.world(), scene.light, scene.low, scene.high, Random(1, Purpose::kTest),
                    {.photons = 20'000});
  const Vec3 centre = (scene.low + scene.high) * 0.5, forward = normalised({0.3, -0.2, 0.9});
  for (const double g : {0.0, 0.5, -0.9, 0.95}) {
    const Guide::Directions directions = guide.directions(centre, forward, g);
    REQUIRE(directions.known());
    Random random(2, Purpose::kTest);
    // The density integrates to 1 over the sphere ..
    double sum = 0.0, square = 0.0;
    const int count = 400'000;
    for (int i = 0; i < count; ++i) {
      const double p = 4.0 * std::numbers::pi * directions.density(uniform_direction(random));
      sum += p;
      square += p * p;
    }
    const double mean = sum / count, error = std::sqrt((square / count - mean * mean) / count);
    INFO("g " << g << ": " << mean << " +- " << error);
    CHECK(std::abs(mean - 1.0) <= 4.0 * error);
    CHECK(error < 0.03);
    // .. and samples weighed by one over it are uniform: moments of a coordinate.
    double first = 0.0, second = 0.0;
    std::array<double, 2> squares{};
    for (int i = 0; i < count; ++i) {
      const Vec3 d = directions.sample(random.uniform(), random);
      const double weight = 1.0 / (4.0 * std::numbers::pi * directions.density(d));
      first += weight * d.z;
      second += weight * d.z * d.z;
      squares[0] += weight * d.z * weight * d.z;
      squares[1] += weight * d.z * d.z * weight * d.z * d.z;
    }
    CHECK(std::abs(first / count) <= 4.0 * std::sqrt(squares[0]) / count);
    CHECK(std::abs(second / count - 1.0 / 3.0) <= 4.0 * std::sqrt(squares[1]) / count);
  }
}

TEST_CASE("a guide without photons or without light steers nowhere") {
  SceneModel scene = draw_scene({}, {}, 4, 2);
  const auto make = [&](int64_t photons) {
    return Guide(scene.world(), scene.light, scene.low, scene.high, Random(1, Purpose::kTest),
                 {.photons = photons});
  };
  CHECK_FALSE(make(0).directions({}, {0.0, 0.0, 1.0}, 0.0).known());
  scene.light.flash.radiance = 0.0;
  scene.light.environment = Environment(Rgb{});
  const Guide dark = make(100);
  CHECK_FALSE(dark.directions({}, {0.0, 0.0, 1.0}, 0.0).known());
  CHECK(dark.directions({}, {0.0, 0.0, 1.0}, 0.0).density({0.0, 0.0, 1.0}) == 0.0);
}

TEST_CASE("a guide gives unit directions and their density, however thin the body") {
  for (const Vec3& half :
       {Vec3{0.2, 0.2, 0.2}, Vec3{1e-3, 1e-3, 0.2}, Vec3{0.2, 0.2, 0.0}, Vec3{0.2, 0, 0}}) {
    INFO("half-widths " << half.x << " " << half.y << " " << half.z);
    const auto geometry = make_mesh_geometry(make_box(-half, half));
    Illumination light;
    light.environment = Environment(Rgb{1.0, 1.0, 1.0});
    const World world{.geometry = geometry.get(), .light = &light};
    const Guide guide(world, light, -half, half, Random(1, Purpose::kTest), {.photons = 2000});
    Random random(2, Purpose::kTest);
    for (int i = 0; i < 200; ++i) {
      const Vec3 position{half.x * random.uniform(-1, 1), half.y * random.uniform(-1, 1),
                          half.z * random.uniform(-1, 1)};
      const Guide::Directions directions = guide.directions(position, {0.0, 0.0, 1.0}, 0.3);
      if (!directions.known()) continue;
      const Vec3 direction = directions.sample(random.uniform(), random);
      REQUIRE(norm(direction) == Approx(1.0));
      const double density = directions.density(direction);
      REQUIRE((density > 0.0 && std::isfinite(density)));
    }
  }
}
