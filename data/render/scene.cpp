#include "data/render/scene.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/error.h"
#include "data/render/render.h"

namespace opaline::render {
namespace {

constexpr double kPi = std::numbers::pi;
/// Streams of an attempt at a scene: the object and its light, the room, what is taken from the assets.
constexpr uint32_t kStreamsPerAttempt = 3;

/// One of the collection, with this probability; its name is put into `name`.
template <class T>
std::optional<T> draw_from(const Collection<T>& collection, double share, std::string_view what,
                           std::string& name, Random& random) {
  constexpr int kMostTries = 1000;
  const bool wanted = random.uniform() < share && !collection.names.empty();
  for (int i = 0; wanted && i < kMostTries; ++i) {
    const size_t index = random.below(static_cast<uint32_t>(collection.names.size()));
    std::optional<T> found = collection.load(index);
    if (!found) continue;
    name = collection.names[index];
    return found;
  }
  if (wanted) {
    fail_usage("render", "{} draws in a row from {} {} gave none that can be used", kMostTries,
               collection.names.size(), what);
  }
  return std::nullopt;
}

}  // namespace

std::vector<Family> all_families() {
  std::vector<Family> families;
  for (size_t i = 0; i < kFamilyNames.size(); ++i) families.push_back(static_cast<Family>(i));
  return families;
}

SceneModel draw_scene(const SceneRanges& ranges, const Camera& camera, uint64_t seed, uint32_t number,
                      uint32_t attempt, const Assets& assets) {
  const uint32_t stream = attempt * kStreamsPerAttempt;
  Random random(seed, Purpose::kScene, stream, number);
  const Family family = ranges.families[random.below(static_cast<uint32_t>(ranges.families.size()))];
  const double radius = draw_uniform(ranges.radius, random);
  const Vec3 offset{random.uniform(-ranges.offset, ranges.offset),
                    random.uniform(-ranges.offset, ranges.offset),
                    random.uniform(-ranges.offset, ranges.offset)};

  SceneModel scene;
  for (double& value : scene.medium.sigma_t) value = draw_uniform(ranges.sigma_t, random);
  for (double& value : scene.medium.albedo) value = draw_uniform(ranges.albedo, random);
  scene.medium.g = draw_uniform(ranges.g, random);
  scene.light.flash.radiance = draw_uniform(ranges.flash, random);
  const double share = draw_log_uniform(ranges.environment, random);

  scene.object = fmt::format("{}-{}-{}", kFamilyNames[static_cast<size_t>(family)], seed, number);
  scene.environment = fmt::format("room-{}-{}", seed, number);
  std::string bumps;
  Random choice(seed, Purpose::kScene, stream + 2, number);
  auto object = draw_from(assets.objects, ranges.object_share, "objects", scene.object, choice);
  const auto map = draw_from(assets.bumps, ranges.bump_share, "bump maps", bumps, choice);
  auto panorama = draw_from(assets.panoramas, ranges.panorama_share, "panoramas", scene.environment, choice);
  if (map) scene.object += " + " + bumps;

  if (panorama) {
    scene.light.environment = std::move(*panorama);
    scene.light.environment.turn(choice.uniform());
  } else {
    Random room(seed, Purpose::kScene, stream + 1, number);
    scene.light.environment = make_room(room, ranges.room);
  }
  const double wanted = share * scene.light.flash.irradiance({});
  const double given = mean(scene.light.environment.fluence()) / 4.0;
  if (!(given > 0.0)) fail_usage("render", "{} sheds no light on the object", scene.environment);
  scene.light.environment.scale(wanted / given);

  const ShapeOptions shape{.radius = radius,
                           .bump = ranges.bump,
                           .facet = [&](const Vec3& p) { return 0.5 * camera.pixel_size(p.z + offset.z); },
                           .map = map ? &*map : nullptr};
  Mesh mesh = finish_body(object ? std::move(*object) : draw_body(family, random), shape, random);
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
