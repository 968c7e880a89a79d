// The scenes that `opaline bench render` measures: one fixed body in different light and media, so that
// figures of different versions of the renderer can be compared.
#pragma once

#include <array>
#include <string_view>

#include "data/render/mesh.h"
#include "data/render/scene.h"

namespace opaline::cli {

struct BenchScene {
  std::string_view name;
  std::string_view text;  ///< what it is, in a few words
  render::Medium medium;
  /// Adds the light; the scene has none before.
  void (*light)(render::Illumination& light);
  /// A medium and light that other renderers can express as well: what --export writes.
  bool portable = false;
};

/// Every scene; the two of the room of contrast 1e5 are called kContrast and kContrastUniform.
inline constexpr std::string_view kContrast = "contrast";
inline constexpr std::string_view kContrastUniform = "contrast-uniform";
const std::array<BenchScene, 7>& bench_scenes();

/// A dented pebble with ripples, about 0.3 m across, its facets at most half a pixel wide.
render::Mesh bench_body(const render::Camera& camera);

render::SceneModel make_bench_scene(const BenchScene& scene, const render::Camera& camera);

}  // namespace opaline::cli
