#include "data/render/surface.h"

#include <catch2/catch.hpp>
#include <cmath>
#include <numbers>

#include "core/error.h"
#include "data/render/isosurface.h"
#include "data/render/noise.h"

using namespace opaline;
using namespace opaline::render;

namespace {

double longest_of(const Surface& surface) {
  return longest_edge(to_mesh(surface));
}

Surface octahedron() {
  return {
      .points = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}},
      .triangles = {{0, 2, 4}, {2, 1, 4}, {1, 3, 4}, {3, 0, 4}, {2, 0, 5}, {1, 2, 5}, {3, 1, 5}, {0, 3, 5}}};
}

}  // namespace

TEST_CASE("refinement keeps a surface closed and its edges short, everywhere or by place") {
  for (const bool curved : {false, true}) {
    Surface even = octahedron();
    even.curved = curved;
    refine(even, [](const Vec3&) { return 0.1; });
    CHECK(describe_leak(to_mesh(even)) == "");
    CHECK(longest_of(even) <= 0.1);
    Surface uneven = octahedron();
    uneven.curved = curved;
    refine(uneven, [](const Vec3& p) { return 0.2 - 0.15 * p.z; });
    CHECK(describe_leak(to_mesh(uneven)) == "");
    CHECK(uneven.triangles.size() < even.triangles.size());
  }
}

TEST_CASE("refinement leaves flat facets where they are and rounds curved ones") {
  Surface flat = octahedron();
  flat.curved = false;
  refine(flat, [](const Vec3&) { return 0.2; });
  CHECK(enclosed_volume(to_mesh(flat)) == Approx(4.0 / 3.0).epsilon(1e-6));
  Surface ball = to_surface(cube_sphere(3));
  refine(ball, [](const Vec3&) { return 0.05; });
  for (const Vec3& p : ball.points) REQUIRE(norm(p) == Approx(1.0).margin(0.01));
}

TEST_CASE("a surface that would take too many triangles is refused") {
  Surface body = octahedron();
  CHECK_THROWS_AS(refine(body, [](const Vec3&) { return 1e-6; }), Error);
}

TEST_CASE("degenerate triangles go without opening the surface") {
  Surface body = octahedron();
  // A point in the middle of edge 0-2 (a cap of no height on one side), and a copy of point 4 (a needle).
  body.points.push_back({0.5, 0.5, 0.0});
  body.points.push_back({0.0, 0.0, 1.0});
  body.triangles = {{0, 6, 2}, {0, 2, 4}, {7, 1, 4}, {2, 7, 4}, {2, 1, 7}, {1, 3, 4},
                    {3, 0, 4}, {2, 6, 5}, {6, 0, 5}, {1, 2, 5}, {3, 1, 5}, {0, 3, 5}};
  Mesh before;
  for (const Vec3& p : body.points)
    before.vertices.push_back({static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z)});
  before.triangles = body.triangles;
  REQUIRE(describe_leak(before) == "");
  const Mesh mesh = to_mesh(body);
  CHECK(describe_leak(mesh) == "");
  CHECK(mesh.triangles.size() == 10);
  CHECK(enclosed_volume(mesh) == Approx(4.0 / 3.0));
}

TEST_CASE("the isosurface of a ball is a closed ball") {
  const Field ball = [](const Vec3& p) { return norm(p - Vec3{0.1, 0.0, -0.05}) - 0.7; };
  Surface surface = extract_isosurface(ball, 1.0, 40);
  const Mesh mesh = to_mesh(surface);
  CHECK(describe_leak(mesh) == "");
  CHECK(enclosed_volume(mesh) == Approx(4.0 / 3.0 * std::numbers::pi * 0.343).epsilon(0.01));
  for (const Vec3& p : surface.points) REQUIRE(std::abs(ball(p)) < 1e-4);
}

TEST_CASE("an isosurface is closed whatever the field") {
  // Noise finer than the grid, which no grid can follow, cut off by the cube's sides.
  for (uint32_t key = 0; key < 10; ++key) {
    const Field field = [key](const Vec3& p) { return gradient_noise(p * 9.0, key); };
    const Mesh mesh = to_mesh(extract_isosurface(field, 1.0, 20));
    REQUIRE(mesh.triangles.size() > 100);
    CHECK(describe_leak(mesh) == "");
    CHECK(enclosed_volume(mesh) > 0.0);
  }
  CHECK(extract_isosurface([](const Vec3&) { return 1.0; }, 1.0, 16).triangles.empty());
  CHECK(describe_leak(to_mesh(extract_isosurface([](const Vec3&) { return -1.0; }, 1.0, 16))) == "");
  const Field nowhere = [](const Vec3&) { return std::nan(""); };
  CHECK(extract_isosurface(nowhere, 1.0, 16).triangles.empty());
}

TEST_CASE("of several pieces the largest stays") {
  const Field two = [](const Vec3& p) {
    return std::min(norm(p - Vec3{0.5, 0, 0}) - 0.2, norm(p + Vec3{0.3, 0, 0}) - 0.4);
  };
  Surface surface = extract_isosurface(two, 1.0, 40);
  keep_largest_piece(surface);
  CHECK(describe_leak(to_mesh(surface)) == "");
  CHECK(enclosed_volume(to_mesh(surface)) == Approx(4.0 / 3.0 * std::numbers::pi * 0.064).epsilon(0.02));
}
