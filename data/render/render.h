// A scene rendered to images and ground truth.
#pragma once

#include <array>
#include <cstdint>
#include <string_view>
#include <vector>

#include "data/render/scene.h"

namespace opaline::render {

/// Images, channels last, row by row from the top.
struct SceneRender {
  int width = 0;
  int height = 0;
  std::vector<float> image;     ///< H x W x 9: S0.R S0.G S0.B S1.R .. S2.B, linear
  std::vector<float> bsdf;      ///< H x W x 9 without the medium
  std::vector<float> normal;    ///< H x W x 3; zero off the object
  std::vector<float> depth;     ///< H x W, z / kCube; zero off the object
  std::vector<float> coverage;  ///< H x W: share of the samples that meet the object
  PathFaults faults;
};

/// Which images are called "pure BSDF": the dielectric without its medium, or its first reflection alone.
enum class BsdfReading { kClear, kReflection };
inline constexpr std::array<std::string_view, 2> kBsdfReadingNames = {"clear", "reflection"};

struct RenderOptions {
  int64_t spp = 32;  ///< samples a pixel, rounded up to a square: they are stratified
  BsdfReading bsdf = BsdfReading::kClear;
  GuideOptions guide{};
  uint64_t seed = 0;
  uint32_t number = 0;
};

/// Renders the scene with all threads, or with the calling thread inside a parallel region. Bitwise the same
/// for any number of them: each pixel has its own stream.
SceneRender render_scene(const SceneModel& scene, const Camera& camera, const RenderOptions& options);

/// Whether the object covers at least one whole pixel and none at the image's border.
bool well_framed(const std::vector<float>& coverage, int width, int height);

}  // namespace opaline::render
