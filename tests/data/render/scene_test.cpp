#include "data/render/render.h"

#include <catch2/catch.hpp>
#include <cmath>

#include "core/parallel.h"

using namespace opaline;
using namespace opaline::render;

namespace {

SceneRender small_render(uint32_t number, BsdfReading bsdf = BsdfReading::kClear) {
  const Camera camera{.width = 24, .height = 24};
  const SceneModel scene = draw_scene({}, camera, 1, number);
  return render_scene(scene, camera, {.spp = 4, .bsdf = bsdf, .photons = 1000, .seed = 1, .number = number});
}

}  // namespace

TEST_CASE("the camera looks along -z with x to the right and y up") {
  const Camera camera{.width = 64, .height = 32};
  const CameraRay centre = camera.ray(32, 16);
  CHECK(centre.direction.z == Approx(-1.0));
  CHECK(centre.axis.x == Approx(1.0));
  CHECK(camera.ray(64, 16).direction.x > 0.0);
  CHECK(camera.ray(32, 0).direction.y > 0.0);
  const Vec3 left = camera.ray(0, 16).direction;
  CHECK(2.0 * std::atan(-left.x / -left.z) * 180.0 / 3.14159265 == Approx(39.3).epsilon(1e-6));
  for (const double x : {0.0, 20.0, 63.0}) {
    const CameraRay ray = camera.ray(x, 5.0);
    CHECK(dot(ray.axis, ray.direction) == Approx(0.0).margin(1e-12));
    CHECK(norm(ray.axis) == Approx(1.0));
  }
}

TEST_CASE("a render is the same to the bit for any number of threads") {
  set_num_threads(1);
  const SceneRender one = small_render(3);
  set_num_threads(3);
  const SceneRender three = small_render(3);
  set_num_threads(0);
  CHECK(one.image == three.image);
  CHECK(one.bsdf == three.bsdf);
  CHECK(one.normal == three.normal);
  CHECK(one.depth == three.depth);
  CHECK(one.coverage == three.coverage);
}

TEST_CASE("truth is unit normals towards the camera and depth in the cube") {
  const SceneRender r = small_render(5);
  int whole = 0;
  double inward = 0.0;
  for (size_t p = 0; p < r.depth.size(); ++p) {
    const double length = std::hypot(r.normal[3 * p], r.normal[3 * p + 1], r.normal[3 * p + 2]);
    if (r.coverage[p] > 0.0F) {
      REQUIRE(length == Approx(1.0).epsilon(1e-5));
      REQUIRE(std::abs(r.depth[p]) <= 1.0F);
      inward = std::min(inward, double{r.normal[3 * p + 2]});
    } else {
      REQUIRE(length == 0.0);
    }
    if (r.coverage[p] >= 1.0F) ++whole;
  }
  CHECK(whole > 20);
  CHECK(inward > -0.35);  // perspective alone turns a visible normal away from z
}

TEST_CASE("outside of the object both images are the environment, unpolarised") {
  const SceneRender r = small_render(2);
  const auto width = static_cast<size_t>(r.width);
  for (size_t p = width + 1; p + width + 1 < r.depth.size(); ++p) {
    // Light from its source finds what few samples miss of the object at a pixel's edge.
    bool outside = true;
    for (const size_t row : {p - width, p, p + width})
      for (const size_t q : {row - 1, row, row + 1}) outside = outside && r.coverage[q] == 0.0F;
    if (!outside) continue;
    for (size_t c = 0; c < 9; ++c) {
      REQUIRE(r.image[9 * p + c] == r.bsdf[9 * p + c]);
      if (c >= 3) REQUIRE(r.image[9 * p + c] == 0.0F);
    }
  }
}

TEST_CASE("polarised light is never more than all light") {
  for (const BsdfReading reading : {BsdfReading::kClear, BsdfReading::kReflection}) {
    const SceneRender r = small_render(7, reading);
    for (const auto* image : {&r.image, &r.bsdf}) {
      for (size_t p = 0; p < r.depth.size(); ++p) {
        for (size_t c = 0; c < 3; ++c) {
          const double s0 = (*image)[9 * p + c], s1 = (*image)[9 * p + 3 + c], s2 = (*image)[9 * p + 6 + c];
          REQUIRE(std::hypot(s1, s2) <= s0 * (1.0 + 1e-4) + 1e-6);
        }
      }
    }
  }
}

TEST_CASE("a reflection is less than the clear dielectric") {
  const SceneRender clear = small_render(7, BsdfReading::kClear),
                    mirror = small_render(7, BsdfReading::kReflection);
  double sum_clear = 0.0, sum_mirror = 0.0;
  for (size_t p = 0; p < clear.depth.size(); ++p) {
    sum_clear += clear.bsdf[9 * p];
    sum_mirror += mirror.bsdf[9 * p];
  }
  CHECK(sum_mirror < sum_clear);
  CHECK(clear.image == mirror.image);
}

TEST_CASE("the environment has the share of the flash's light that was asked for") {
  for (uint32_t number = 0; number < 8; ++number) {
    const SceneModel scene = draw_scene({}, {.width = 16, .height = 16}, 1, number);
    const double share = mean(scene.light.environment.fluence()) / 4.0 / scene.light.flash.irradiance({});
    CHECK((share >= 0.0499 && share <= 0.5001));
    CHECK((scene.light.flash.radiance >= 35.0 && scene.light.flash.radiance <= 75.0));
    for (size_t c = 0; c < 3; ++c) {
      CHECK((scene.medium.sigma_t[c] >= 0.0 && scene.medium.sigma_t[c] <= 32.0));
      CHECK((scene.medium.albedo[c] >= 0.3 && scene.medium.albedo[c] <= 0.95));
    }
  }
}

TEST_CASE("facets are at most about half a pixel") {
  const Camera camera{.width = 32, .height = 32};
  SceneRanges ranges;
  ranges.families = {Family::kSuperquadric};
  const SceneModel scene = draw_scene(ranges, camera, 1, 1);
  // Neighbouring rays half a pixel apart meet other facets nearly always.
  int same = 0, both = 0;
  for (int i = 0; i < 400; ++i) {
    const double x = 12.0 + i % 20 * 0.4, y = 12.0 + i / 20 * 0.4;
    Hit a, b;
    const CameraRay u = camera.ray(x, y), v = camera.ray(x + 0.9, y + 0.9);
    if (!scene.geometry->intersect(u.origin, u.direction, kInfinity, a)) continue;
    if (!scene.geometry->intersect(v.origin, v.direction, kInfinity, b)) continue;
    ++both;
    if (a.normal.x == b.normal.x && a.normal.y == b.normal.y && a.normal.z == b.normal.z) ++same;
  }
  CHECK(both > 100);
  CHECK(same <= both / 20);
}

TEST_CASE("an object at the border or off the picture is seen") {
  std::vector<float> coverage(9, 0.0F);
  CHECK_FALSE(well_framed(coverage, 3, 3));
  coverage[4] = 0.5F;
  CHECK_FALSE(well_framed(coverage, 3, 3));
  coverage[4] = 1.0F;
  CHECK(well_framed(coverage, 3, 3));
  coverage[1] = 0.1F;
  CHECK_FALSE(well_framed(coverage, 3, 3));
}
