#include "data/render/scene.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/error.h"
#include "data/render/render.h"
#include "data/render/room.h"

namespace opaline::render {
namespace {

constexpr double kPi = std::numbers::pi;
/// Streams of an attempt at a scene: the object and its light, the room.
constexpr uint32_t kStreamsPerAttempt = 2;

double draw(const Range& range, Random& random) {
  return random.uniform(range.low, range.high);
}

double mean(const Rgb& c) {
  return (c[0] + c[1] + c[2]) / 3.0;
}

}  // namespace

CameraRay Camera::ray(double x, double y) const {
  const double half = std::tan(0.5 * field * kPi / 180.0);
  const double scale = 2.0 * half / width;
  const Vec3 direction = normalised({(x - 0.5 * width) * scale, (0.5 * height - y) * scale, -1.0});
  // The image's x axis, projected perpendicular to the ray.
  const Vec3 axis = normalised(Vec3{1.0, 0.0, 0.0} - direction * direction.x);
  return {position, direction, axis};
}

double Camera::pixel_size(double z) const {
  return 2.0 * std::tan(0.5 * field * kPi / 180.0) * (position.z - z) / width;
}

SceneModel draw_scene(const SceneRanges& ranges, const Camera& camera, uint64_t seed, uint32_t number,
                      uint32_t attempt) {
  if (ranges.families.empty()) fail_usage("render", "no family of shapes to draw objects from");
  const auto stream = attempt * kStreamsPerAttempt;
  Random random(seed, Purpose::kScene, stream, number);
  const Family family = ranges.families[random.below(static_cast<uint32_t>(ranges.families.size()))];
  const double radius = draw(ranges.radius, random);
  const Vec3 offset{random.uniform(-ranges.offset, ranges.offset),
                    random.uniform(-ranges.offset, ranges.offset),
                    random.uniform(-ranges.offset, ranges.offset)};

  SceneModel scene;
  for (double& value : scene.medium.sigma_t) value = draw(ranges.sigma_t, random);
  for (double& value : scene.medium.albedo) value = draw(ranges.albedo, random);
  scene.medium.g = draw(ranges.g, random);
  scene.light.flash.radiance = draw(ranges.flash, random);
  const double share =
      ranges.environment.low * std::pow(ranges.environment.high / ranges.environment.low, random.uniform());

  Random room(seed, Purpose::kScene, stream + 1, number);
  scene.light.environment = make_room(room);
  const double wanted = share * scene.light.flash.irradiance({});
  scene.light.environment.scale(wanted / mean(scene.light.environment.irradiance({0.0, 0.0, 1.0})));

  // Quads of the body at the depth of its nearest point: a quarter of a great circle in `sides` steps, some
  // of them up to twice as long as others.
  const double facet = 0.5 * camera.pixel_size(offset.z + radius);
  const int sides = std::clamp(static_cast<int>(std::ceil(0.5 * kPi * radius / facet)), 16, 1024);
  Mesh mesh = make_shape({.family = family, .sides = sides, .radius = radius, .bump = ranges.bump}, random);
  scene.low = scene.high = offset;
  for (auto& v : mesh.vertices) {
    v = {v[0] + static_cast<float>(offset.x), v[1] + static_cast<float>(offset.y),
         v[2] + static_cast<float>(offset.z)};
    scene.low = {std::min(scene.low.x, double{v[0]}), std::min(scene.low.y, double{v[1]}),
                 std::min(scene.low.z, double{v[2]})};
    scene.high = {std::max(scene.high.x, double{v[0]}), std::max(scene.high.y, double{v[1]}),
                  std::max(scene.high.z, double{v[2]})};
  }
  scene.geometry = make_mesh_geometry(mesh);
  scene.object = fmt::format("{}-{}-{}", kFamilyNames[static_cast<size_t>(family)], seed, number);
  scene.environment = fmt::format("room-{}-{}", seed, number);
  return scene;
}

bool likely_well_framed(const SceneModel& scene, const Camera& camera) {
  std::vector<float> coverage;
  coverage.reserve(static_cast<size_t>(camera.width) * static_cast<size_t>(camera.height));
  for (int i = 0; i < camera.height; ++i) {
    for (int j = 0; j < camera.width; ++j) {
      const CameraRay ray = camera.ray(j + 0.5, i + 0.5);
      Hit hit;
      coverage.push_back(scene.geometry->intersect(ray.origin, ray.direction, kInfinity, hit) ? 1.0F : 0.0F);
    }
  }
  return well_framed(coverage, camera.width, camera.height);
}

}  // namespace opaline::render
