// One scene of a data set, drawn from a seed.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <vector>

#include "data/render/assets.h"
#include "data/render/camera.h"
#include "data/render/path.h"
#include "data/render/range.h"
#include "data/render/room.h"
#include "data/render/shapes.h"

namespace opaline::render {

/// Half-width of the cube that objects stay in, metres: the unit of depth.
inline constexpr double kCube = 0.25;

/// Every family.
std::vector<Family> all_families();

/// Ranges that scenes are drawn from, uniformly; the environment's share log-uniformly.
struct SceneRanges {
  std::vector<Family> families = all_families();
  Range radius{0.14, 0.21};  ///< of the ball around the object, metres
  double offset = 0.03;      ///< of its centre from the cube's, along each axis at most, metres
  double bump = 0.25;        ///< largest slope of bumps
  Range sigma_t{0.0, 32.0};  ///< per metre and colour
  Range albedo{0.3, 0.95};   ///< per colour
  Range g{0.0, 0.9};
  Range flash{35.0, 75.0};  ///< radiance
  /// Irradiance at the cube's centre, mean over the ways to face (fluence / 4) / the flash's there. Not that
  /// of a plane that faces the camera: a lamp behind the body would not count, and be scaled to outshine all.
  Range environment{0.05, 0.5};
  RoomOptions room{};
  double object_share = 1.0;    ///< of scenes whose object is from the assets, where there are any
  double bump_share = 1.0;      ///< the same of bumps
  double panorama_share = 1.0;  ///< the same of environments
};

/// Everything that a scene consists of. Movable; `world()` points into it.
struct SceneModel {
  std::string object;  ///< name of what was drawn
  std::string environment;
  Illumination light;
  Medium medium;
  std::unique_ptr<Geometry> geometry;
  Vec3 low, high;  ///< corners of the box around the object

  World world() const {
    return {.geometry = geometry.get(), .light = &light, .medium = medium, .index = kRefractiveIndex};
  }
};

/// A scene is a function of (seed, number) and the assets of its split. Training and test scenes have
/// different numbers, hence other bodies and rooms. No edge of a facet is longer than half a pixel of
/// `camera` at its depth.
SceneModel draw_scene(const SceneRanges& ranges, const Camera& camera, uint64_t seed, uint32_t number,
                      uint32_t attempt = 0, const Assets& assets = {});

/// Whether the object covers a pixel and leaves the image's border free, judged by one ray through the middle
/// of each pixel: quick, before a scene is rendered.
bool likely_well_framed(const SceneModel& scene, const Camera& camera);

}  // namespace opaline::render
