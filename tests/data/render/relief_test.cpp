#include "data/render/relief.h"

#include <catch2/catch.hpp>
#include <cmath>

#include "data/render/noise.h"

using namespace opaline;
using namespace opaline::render;

namespace {

/// The largest slope of the relief over the unit sphere, between points 0.002 apart.
double steepest(const Relief& relief, Random& random) {
  double slope = 0.0;
  for (int i = 0; i < 4000; ++i) {
    const Vec3 p = around({0, 0, 1}, random.uniform(-1, 1), random.uniform(0, 6.28));
    const Vec3 q = around(p, std::cos(0.002), random.uniform(0, 6.28));
    slope = std::max(slope, std::abs(relief.height(p, p) - relief.height(q, q)) / norm(p - q));
  }
  return slope;
}

HeightMap waves() {
  HeightMap map{.name = "waves", .width = 48, .height = 32, .values = {}};
  for (int j = 0; j < map.height; ++j)
    for (int i = 0; i < map.width; ++i)
      map.values.push_back(100.0F + 50.0F * std::sin(0.5F * static_cast<float>(i)) *
                                        std::cos(0.3F * static_cast<float>(j)));
  return map;
}

}  // namespace

TEST_CASE("bumps of noise have slopes up to about 1") {
  for (uint32_t number = 0; number < 24; ++number) {
    Random random(1, Purpose::kTest, 0, number);
    const Relief relief = draw_noise_relief(random);
    const double slope = steepest(relief, random);
    INFO(number);
    CHECK(slope > 0.3);
    CHECK(slope < 1.2);
  }
}

TEST_CASE("bumps of a map have slopes up to about 1, whatever its grey values") {
  const HeightMap map = waves();
  for (uint32_t number = 0; number < 8; ++number) {
    Random random(2, Purpose::kTest, 0, number);
    const Relief relief = draw_map_relief(map, random);
    const double slope = steepest(relief, random);
    CHECK(slope > 0.3);
    CHECK(slope < 1.2);
  }
  const HeightMap plain{.name = "plain", .width = 2, .height = 2, .values = {7, 7, 7, 7}};
  Random random(2, Purpose::kTest);
  CHECK(draw_map_relief(plain, random).amplitude == 0.0);
}

TEST_CASE("displacement moves points along their normals, less where the surface bends") {
  Surface ball = to_surface(cube_sphere(30));
  const Relief bumps{[](const Vec3&, const Vec3&) { return 0.1; }, 0.1};
  displace(ball, bumps, 0.5);
  for (const Vec3& p : ball.points) REQUIRE(norm(p) == Approx(1.05).epsilon(1e-3));
  Surface small = to_surface(cube_sphere(30));
  for (Vec3& p : small.points) p = p * 0.05;
  displace(small, {[](const Vec3&, const Vec3&) { return -1.0; }, 1.0}, 1.0);
  for (const Vec3& p : small.points) REQUIRE((norm(p) > 0.02 && norm(p) < 0.05));
  Surface thin = to_surface(cube_sphere(30));
  thin.thickness = 0.1;
  displace(thin, {[](const Vec3&, const Vec3&) { return 1.0; }, 1.0}, 1.0);
  for (const Vec3& p : thin.points) REQUIRE(norm(p) == Approx(1.02).epsilon(1e-3));
}

TEST_CASE("cell noise is a distance") {
  Random random(4, Purpose::kTest);
  for (int i = 0; i < 2000; ++i) {
    const Vec3 p{random.uniform(-9, 9), random.uniform(-9, 9), random.uniform(-9, 9)};
    const Vec3 q = p + around({0, 0, 1}, random.uniform(-1, 1), random.uniform(0, 6.28)) * 0.1;
    const double a = cell_noise(p, 3), b = cell_noise(q, 3);
    REQUIRE((a >= 0.0 && a <= 1.0));
    REQUIRE(std::abs(a - b) <= 0.1 + 1e-9);
  }
}
