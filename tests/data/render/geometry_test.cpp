#include "data/render/geometry.h"

#include <catch2/catch.hpp>
#include <cmath>

#include "data/render/path.h"
#include "data/render/solids.h"

using namespace opaline;
using namespace opaline::render;

namespace {

Mesh touching_cubes() {
  return joined(make_box({-1, -1, -1}, {0, 1, 1}), make_box({0, -1, -1}, {1, 1, 1}));
}

class Uniform final : public Light {
 public:
  Rgb radiance(const Vec3&, const Vec3&) const override { return {1.0, 1.0, 1.0}; }
  Rgb background(const Vec3&) const override { return {1.0, 1.0, 1.0}; }
};

}  // namespace

TEST_CASE("a ray crosses from a body into one that shares a face with it") {
  const auto geometry = make_mesh_geometry(touching_cubes());
  for (const Vec3& towards : {Vec3{1.0, 0.0, 0.0}, Vec3{0.5, 0.6, -0.2}, Vec3{0.01, 0.7, 0.5}}) {
    const Vec3 d = normalised(towards);
    Hit out, in;
    REQUIRE(geometry->next(d * -0.4, d, true, kInfinity, out) == Meeting::kSurface);
    CHECK(out.position.x == Approx(0.0).margin(1e-6));
    CHECK(out.normal.x == Approx(1.0));
    const Vec3 start = geometry->start(out, d, false);
    REQUIRE(geometry->next(start, d, false, kInfinity, in) == Meeting::kSurface);
    CHECK(in.normal.x == Approx(-1.0));
    CHECK(norm(in.position - out.position) < 1e-4);
    // What is reflected between them meets the first again.
    const Vec3 back{-d.x, d.y, d.z};
    REQUIRE(geometry->next(geometry->start(in, back, false), back, false, kInfinity, in) ==
            Meeting::kSurface);
    CHECK(in.normal.x == Approx(1.0));
    CHECK(norm(in.position - out.position) < 1e-4);
  }
}

TEST_CASE("a start that rounding put outside gets the facet that it should have met") {
  const auto geometry = make_mesh_geometry(make_box({-1, -1, -1}, {1, 1, 1}));
  Hit hit;
  // Just outside, on the way out: the surface is where it starts.
  REQUIRE(geometry->next({0, 0, 1 + 3e-7}, {0, 0, 1}, true, kInfinity, hit) == Meeting::kSurface);
  CHECK(hit.distance == 0.0);
  CHECK(hit.position.z == Approx(1.0));
  // On the way in: that facet is not in the way.
  REQUIRE(geometry->next({0, 0, 1 + 3e-7}, {0, 0, -1}, true, kInfinity, hit) == Meeting::kSurface);
  CHECK(hit.position.z == Approx(-1.0));
  // Far outside there is nothing to be done, whether the ray meets the body or not.
  CHECK(geometry->next({0, 0, 2}, {0, 0, 1}, true, kInfinity, hit) == Meeting::kLost);
  CHECK(geometry->next({0, 0, 2}, {0, 0, -1}, true, kInfinity, hit) == Meeting::kLost);
  // Short of the surface a flight ends in the medium.
  CHECK(geometry->next({0, 0, 0}, {0, 0, 1}, true, 0.5, hit) == Meeting::kNothing);
}

TEST_CASE("points next to a facet are kept as far inside as rays start") {
  const auto geometry = make_mesh_geometry(make_box({-1, -1, -1}, {1, 1, 1}));
  Hit hit;
  REQUIRE(geometry->next({0, 0, 0}, {0, 0, 1}, true, kInfinity, hit) == Meeting::kSurface);
  CHECK(geometry->keep_inside({0.3, 0, 1}, hit).z == geometry->start(hit, {0, 0, -1}, true).z);
  CHECK(geometry->keep_inside({0.3, 0, 0.5}, hit).z == 0.5);
}

TEST_CASE("a ray that rounding takes past an edge is outside") {
  // It grazes the side x = 0.2 at 89 degrees, misses it by 2e-8 and touches the next side from behind.
  const auto geometry = make_mesh_geometry(make_box({-0.2, -0.2, -0.2}, {0.2, 0.2, 0.2}));
  const Vec3 origin{0.212091385, 0.435770885, 0.0785770072};
  const Vec3 direction = normalised({-0.0174524064, -0.917656143, -0.396991961});
  Hit hit;
  REQUIRE(geometry->intersect(origin, direction, kInfinity, hit));
  REQUIRE(dot(direction, hit.normal) > 0.0);
  CHECK(geometry->first(origin, direction, hit) != Meeting::kLost);
}

TEST_CASE("a camera inside a body is noticed") {
  const auto geometry = make_mesh_geometry(touching_cubes());
  Hit hit;
  CHECK(geometry->first({-0.5, 0, 0}, {0, 0, 1}, hit) == Meeting::kLost);
  CHECK(geometry->first({-0.5, 0, 3}, {0, 0, 1}, hit) == Meeting::kNothing);
  CHECK(geometry->first({-0.5, 0, 3}, {0, 0, -1}, hit) == Meeting::kSurface);
  const Uniform light;
  Random random(1, Purpose::kTest);
  PathFaults faults;
  const PathSample sample = sample_path({.geometry = geometry.get(), .light = &light},
                                        {{-0.5, 0, 0}, {0, 0, 1}, {1, 0, 0}}, random, faults);
  CHECK(sample.hit);
  CHECK(faults.lost == 1);
  CHECK(sample.clear[0][0] == 0.0);
}

TEST_CASE("bodies that share a face vanish in uniform light") {
  const auto geometry = make_mesh_geometry(touching_cubes());
  const Uniform light;
  const World world{.geometry = geometry.get(), .light = &light};
  Random random(3, Purpose::kTest);
  PathFaults faults;
  double sum = 0.0;
  constexpr int kCount = 4000;
  for (int i = 0; i < kCount; ++i) {
    const Vec3 d = around({0, 0, -1}, random.uniform(0.1, 1.0), 6.2831853 * random.uniform());
    const Vec3 target{random.uniform(-1, 1), random.uniform(-1, 1), 1.0};
    const CameraRay ray{target - d * 4.0, d, basis_around(d).first};
    sum += sample_path(world, ray, random, faults).clear[0][0];
  }
  CHECK(faults.lost == 0);
  CHECK(sum / kCount == Approx(1.0).margin(0.002));
}
