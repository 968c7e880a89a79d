#include "data/render/shapes.h"

#include <catch2/catch.hpp>
#include <cmath>
#include <numbers>

#include "core/error.h"
#include "data/render/geometry.h"

using namespace opaline;
using namespace opaline::render;

namespace {

Vec3 vertex(const Mesh& mesh, uint32_t i) {
  const auto& v = mesh.vertices[i];
  return {v[0], v[1], v[2]};
}

Vec3 draw_direction(Random& random) {
  return around({0, 0, 1}, random.uniform(-1, 1), random.uniform(0, 6.2831853));
}

/// Surface points along a ray from outside; -1 where two in a row face the same way. With `either`, the ray
/// may start inside, and the answer is 1 for inside and 0 for outside.
int crossings(const Geometry& geometry, Vec3 origin, const Vec3& direction, bool either = false) {
  Hit hit;
  if (either)
    return geometry.intersect(origin, direction, kInfinity, hit) && dot(direction, hit.normal) > 0.0;
  int met = 0;
  while (geometry.intersect(origin, direction, kInfinity, hit)) {
    if ((dot(direction, hit.normal) > 0.0) != (met % 2 == 1)) return -1;
    origin = geometry.leave(hit, direction);
    ++met;
  }
  return met % 2 == 0 ? met : -1;
}

}  // namespace

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

TEST_CASE("every family gives closed bodies inside their ball, with facets under the limit") {
  const auto facet = [](const Vec3& p) { return 0.01 - 0.02 * p.z; };  // 7 to 13 mm
  for (size_t family = 0; family < kFamilyNames.size(); ++family) {
    for (uint32_t number = 0; number < 8; ++number) {
      Random random(5, Purpose::kTest, 0, number);
      const Mesh mesh =
          make_shape(static_cast<Family>(family), {.radius = 0.15, .bump = 0.3, .facet = facet}, random);
      INFO(kFamilyNames[family] << " " << number);
      REQUIRE(describe_leak(mesh) == "");
      // Facing outwards, and not a sliver.
      REQUIRE(enclosed_volume(mesh) > 0.01 * 4.0 / 3.0 * std::numbers::pi * std::pow(0.15, 3));
      double largest = 0.0, over = 0.0, lowest = 1.0;
      for (const auto& v : mesh.vertices) {
        for (const float c : v) REQUIRE(std::isfinite(c));
        largest = std::max(largest, norm({v[0], v[1], v[2]}));
      }
      CHECK(largest == Approx(0.15).epsilon(1e-4));
      for (const auto& t : mesh.triangles) {
        double longest = 0.0;
        for (size_t e = 0; e < 3; ++e) {
          const Vec3 p = vertex(mesh, t[e]), q = vertex(mesh, t[(e + 1) % 3]);
          longest = std::max(longest, norm(q - p));
          over = std::max(over, norm(q - p) / facet((p + q) * 0.5));
        }
        const Vec3 p = vertex(mesh, t[0]);
        lowest = std::min(lowest, norm(cross(vertex(mesh, t[1]) - p, vertex(mesh, t[2]) - p)) / longest);
      }
      CHECK(over <= 1.01);
      CHECK(lowest > 1e-8);  // every facet has a normal
    }
  }
}

TEST_CASE("surfaces of every family separate inside from outside") {
  // What a self-intersection costs is paths that meet the surface from the wrong side.
  for (size_t family = 0; family < kFamilyNames.size(); ++family) {
    int rays = 0, wrong = 0;
    for (uint32_t number = 0; number < 3; ++number) {
      Random random(6, Purpose::kTest, 0, number);
      const auto geometry =
          make_mesh_geometry(make_shape(static_cast<Family>(family), {.radius = 0.15, .bump = 0.3}, random));
      for (int i = 0; i < 2000; ++i) {
        const Vec3 from = draw_direction(random) * 0.2;
        const Vec3 to = draw_direction(random) * (0.15 * random.uniform());
        if (crossings(*geometry, from, normalised(to - from)) < 0) ++wrong;
        ++rays;
      }
    }
    INFO(kFamilyNames[family]);
    CHECK(wrong <= rays / 2000);
  }
}

TEST_CASE("thin and concave families are, convex ones are not") {
  // Of how many pairs of surface points the middle is outside.
  const auto concavity = [](Family family) {
    int outside = 0, pairs = 0;
    for (uint32_t number = 0; number < 5; ++number) {
      Random random(8, Purpose::kTest, 0, number);
      const Mesh mesh = make_shape(family, {.bump = 0.0, .facet = [](const Vec3&) { return 0.02; }}, random);
      const auto geometry = make_mesh_geometry(mesh);
      for (int i = 0; i < 300; ++i) {
        const auto draw = [&] {
          return vertex(mesh, mesh.triangles[random.below(static_cast<uint32_t>(mesh.triangles.size()))][0]);
        };
        const Vec3 middle = (draw() + draw()) * 0.5;
        const int met = crossings(*geometry, middle, draw_direction(random), true);
        ++pairs;
        if (met == 0) ++outside;
      }
    }
    return static_cast<double>(outside) / pairs;
  };
  CHECK(concavity(Family::kSuperquadric) < 0.02);
  for (const Family family : {Family::kTube, Family::kVessel, Family::kSheet}) {
    INFO(kFamilyNames[static_cast<size_t>(family)]);
    CHECK(concavity(family) > 0.3);
  }
  for (const Family family : {Family::kBlend, Family::kCarved, Family::kLathed}) {
    INFO(kFamilyNames[static_cast<size_t>(family)]);
    CHECK(concavity(family) > 0.03);
  }
}

TEST_CASE("tubes have holes") {
  // Vertices - edges + triangles = 2 - 2 x handles.
  int ringed = 0;
  for (uint32_t number = 0; number < 8; ++number) {
    Random random(3, Purpose::kTest, 0, number);
    const Surface body = draw_body(Family::kTube, random);
    const auto euler =
        static_cast<int64_t>(body.points.size()) - static_cast<int64_t>(body.triangles.size()) / 2;
    CHECK(euler % 2 == 0);
    CHECK(euler <= 2);
    if (euler <= 0) ++ringed;
  }
  CHECK(ringed >= 4);
}

TEST_CASE("a body is a function of its stream, and the same body at any facet size") {
  const auto make = [](uint32_t number, double facet) {
    Random random(9, Purpose::kTest, 0, number);
    return make_shape(Family::kBlend, {.facet = [=](const Vec3&) { return facet; }}, random);
  };
  CHECK(make(1, 0.02).vertices == make(1, 0.02).vertices);
  CHECK(make(1, 0.02).vertices != make(2, 0.02).vertices);
  const Mesh coarse = make(1, 0.01), fine = make(1, 0.003);
  CHECK(fine.triangles.size() > 2 * coarse.triangles.size());
  CHECK(enclosed_volume(fine) == Approx(enclosed_volume(coarse)).epsilon(0.02));
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
