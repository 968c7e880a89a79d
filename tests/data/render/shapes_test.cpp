#include "data/render/shapes.h"

#include <catch2/catch.hpp>
#include <cmath>
#include <numbers>

#include "core/error.h"
#include "data/render/geometry.h"

using namespace opaline;
using namespace opaline::render;

TEST_CASE("the cube sphere is closed and round") {
  const Mesh mesh = cube_sphere(24);
  CHECK(describe_leak(mesh).empty());
  CHECK(enclosed_volume(mesh) == Approx(4.0 / 3.0 * std::numbers::pi).epsilon(0.01));
}

TEST_CASE("a missing or reversed triangle is found") {
  Mesh mesh = cube_sphere(4);
  Mesh open = mesh;
  open.triangles.pop_back();
  CHECK_FALSE(describe_leak(open).empty());
  CHECK_THROWS_AS(make_mesh_geometry(open), Error);
  std::swap(mesh.triangles[0][0], mesh.triangles[0][1]);
  CHECK_FALSE(describe_leak(mesh).empty());
}

TEST_CASE("every family gives closed bodies inside their ball") {
  for (size_t family = 0; family < kFamilyNames.size(); ++family) {
    for (uint32_t number = 0; number < 20; ++number) {
      Random random(5, Purpose::kTest, 0, number);
      const Mesh mesh = make_shape(
          {.family = static_cast<Family>(family), .sides = 20, .radius = 0.15, .bump = 0.3}, random);
      INFO(kFamilyNames[family] << " " << number);
      REQUIRE(describe_leak(mesh).empty());
      // Facing outwards, and not a sliver.
      REQUIRE(enclosed_volume(mesh) > 0.02 * 4.0 / 3.0 * std::numbers::pi * std::pow(0.15, 3));
      double largest = 0.0;
      for (const auto& v : mesh.vertices) {
        for (const float c : v) REQUIRE(std::isfinite(c));
        largest = std::max(largest, norm({v[0], v[1], v[2]}));
      }
      REQUIRE(largest == Approx(0.15).epsilon(1e-4));
    }
  }
}

TEST_CASE("a body is a function of its stream") {
  const auto make = [](uint32_t number) {
    Random random(9, Purpose::kTest, 0, number);
    return make_shape({.family = Family::kBlend, .sides = 8}, random).vertices;
  };
  CHECK(make(1) == make(1));
  CHECK(make(1) != make(2));
}

TEST_CASE("rays meet a sphere where it is, from both sides") {
  const auto geometry = make_mesh_geometry(cube_sphere(64));
  Random random(2, Purpose::kTest);
  for (int i = 0; i < 2000; ++i) {
    const double cosine = random.uniform(-1, 1), azimuth = random.uniform(0, 6.28);
    const Vec3 d = around({0, 0, 1}, cosine, azimuth);
    Hit hit;
    REQUIRE(geometry->intersect({}, d, kInfinity, hit));  // from inside
    REQUIRE(hit.distance == Approx(1.0).epsilon(1e-3));
    REQUIRE(dot(hit.normal, d) > 0.99);
    // Leaving on either side, the facet is not met again at once.
    Hit next;
    REQUIRE_FALSE(geometry->intersect(geometry->leave(hit, d), d, kInfinity, next));
    REQUIRE(geometry->intersect(geometry->leave(hit, -d), -d, kInfinity, next));
    REQUIRE(next.distance > 1.5);
    REQUIRE_FALSE(geometry->intersect({}, d, 0.9, next));  // bounded
  }
}

TEST_CASE("rays meet the faces of a slab") {
  const auto slab = make_slab_geometry(2.0);
  Hit hit;
  REQUIRE(slab->intersect({0, 0, 1}, normalised({1, 0, -1}), kInfinity, hit));
  CHECK(hit.position.z == 0.0);
  CHECK(hit.position.x == Approx(1.0));
  REQUIRE(slab->intersect(hit.position, {0, 0, -1}, kInfinity, hit));
  CHECK(hit.distance == Approx(2.0));
  CHECK(hit.normal.z == -1.0);
  CHECK_FALSE(slab->intersect({0, 0, 1}, {0, 0, 1}, kInfinity, hit));
  CHECK_FALSE(make_slab_geometry(kInfinity)->intersect({0, 0, -1}, {0, 0, -1}, kInfinity, hit));
  CHECK_THROWS_AS(make_slab_geometry(0.0), UsageError);
}
