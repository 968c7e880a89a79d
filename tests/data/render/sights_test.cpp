#include "data/render/sights.h"

#include <catch2/catch.hpp>
#include <cmath>
#include <numbers>

#include "core/error.h"
#include "core/random.h"
#include "data/render/scene.h"
#include "data/render/walk.h"

using namespace opaline;
using namespace opaline::render;

namespace {

const Camera kCamera{.width = 16, .height = 16};

SceneModel scene_of(Family family) {
  return draw_scene({.families = {family}}, kCamera, 3, 1);
}

Vec3 point_inside(const SceneModel& scene, Random& random) {
  for (;;) {
    const Vec3 p{random.uniform(scene.low.x, scene.high.x), random.uniform(scene.low.y, scene.high.y),
                 random.uniform(scene.low.z, scene.high.z)};
    Hit hit;
    if (scene.geometry->intersect(p, {0.0, 0.0, 1.0}, kInfinity, hit) && hit.normal.z > 0.0) return p;
  }
}

/// The camera's ray through a point of the image, refracted by a plane: where it is after `length` inside.
Vec3 behind(const Camera& camera, double x, double y, const Vec3& on_plane, const Vec3& normal,
            double length) {
  const CameraRay ray = camera.ray(x, y);
  const double distance = dot(on_plane - ray.origin, normal) / dot(ray.direction, normal);
  const Fresnel f = fresnel(-dot(ray.direction, normal), kRefractiveIndex);
  return ray.origin + ray.direction * distance + refract(ray.direction, normal, f, kRefractiveIndex) * length;
}

}  // namespace

TEST_CASE("a sight is the way that the camera's ray takes") {
  for (const Family family : {Family::kHarmonics, Family::kVessel, Family::kSheet}) {
    const SceneModel scene = scene_of(family);
    const Sights sights(*scene.geometry->mesh(), kCamera, kRefractiveIndex, scene.low, scene.high);
    Random random(1, Purpose::kTest);
    int found = 0;
    for (int i = 0; i < 300; ++i) {
      const Vec3 point = point_inside(scene, random);
      sights.for_each(point, [&](const Sight& s) {
        ++found;
        const Vec3 there = behind(kCamera, s.x, s.y, s.surface, s.normal, s.length);
        REQUIRE(norm(there - point) < 1e-12);
        REQUIRE(norm(s.direction) == Approx(1.0).epsilon(1e-14));
        REQUIRE(norm(s.inside) == Approx(1.0).epsilon(1e-14));
        REQUIRE(norm(s.surface + s.inside * s.length - point) < 1e-12);
        REQUIRE(s.cosine == Approx(-dot(s.direction, s.normal)).epsilon(1e-12));
        REQUIRE(s.length >= sights.shortest(point));
        // The beam's section, by difference quotients over the image; they are poor at grazing incidence.
        constexpr double h = 1e-4;
        const auto at = [&](double dx, double dy) {
          return behind(kCamera, s.x + dx, s.y + dy, s.surface, s.normal, s.length);
        };
        const Vec3 by_x = (at(h, 0) - at(-h, 0)) * (0.5 / h), by_y = (at(0, h) - at(0, -h)) * (0.5 / h);
        REQUIRE(std::abs(dot(cross(by_x, by_y), s.inside)) == Approx(s.section).epsilon(1e-3));
      });
    }
    CHECK(found > 200);
  }
}

TEST_CASE("what the camera's rays reach is seen from there, through the facet that they crossed") {
  for (const Family family : {Family::kHarmonics, Family::kNoise, Family::kVessel, Family::kSheet}) {
    const SceneModel scene = scene_of(family);
    const Sights sights(*scene.geometry->mesh(), kCamera, kRefractiveIndex, scene.low, scene.high);
    Random random(2, Purpose::kTest);
    int tried = 0, missed = 0;
    while (tried < 5000) {
      const double x = random.uniform(0.0, kCamera.width), y = random.uniform(0.0, kCamera.height);
      const CameraRay ray = kCamera.ray(x, y);
      Hit hit;
      if (scene.geometry->first(ray.origin, ray.direction, hit) != Meeting::kSurface) continue;
      const Fresnel f = fresnel(-dot(ray.direction, hit.normal), kRefractiveIndex);
      const Vec3 inside = refract(ray.direction, hit.normal, f, kRefractiveIndex);
      Hit exit;
      if (scene.geometry->next(scene.geometry->start(hit, inside, true), inside, true, kInfinity, exit) !=
          Meeting::kSurface) {
        continue;
      }
      ++tried;
      const double length = exit.distance * random.uniform(0.001, 0.999);
      bool seen = false;
      sights.for_each(hit.position + inside * length, [&](const Sight& s) {
        seen = seen ||
               (std::abs(s.x - x) < 1e-3 && std::abs(s.y - y) < 1e-3 && std::abs(s.length - length) < 1e-5);
      });
      missed += seen ? 0 : 1;
    }
    // Single-precision queries miss the edge of a facet by 1e-7 of their coordinates; facets are 1e-2 wide.
    INFO(scene.object << ": " << missed << " of " << tried);
    CHECK(missed <= 3);
  }
}

TEST_CASE("a camera that is not above the body is refused") {
  const SceneModel scene = scene_of(Family::kHarmonics);
  Camera low = kCamera;
  low.position.z = 0.0;
  CHECK_THROWS_AS(Sights(*scene.geometry->mesh(), low, kRefractiveIndex, scene.low, scene.high), Error);
}
