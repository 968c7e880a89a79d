// A scene rendered to images and ground truth.
//
// A pixel is the sum of three parts that are estimated apart, each as often as it deserves: the mirror image
// on the surface (which also gives coverage and truth), the light that crosses the body without scattering,
// and the light that scatters. With `spp` every pixel gets as many samples of each. With `error` a few pilot
// samples measure how noisy and how dear each part of each pixel is, and are thrown away: what they decide is
// then independent of what is summed, so the image has no bias.
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
  double spp = 0.0;     ///< scattered paths a pixel that the object touches, mean
  int64_t capped = 0;   ///< pixels that wanted more samples than RenderOptions::most
  bool guided = false;  ///< whether the guide was worth its time
  int64_t light_paths = 0;
};

/// Which images are called "pure BSDF": the dielectric without its medium, or its first reflection alone.
enum class BsdfReading { kClear, kReflection };
inline constexpr std::array<std::string_view, 2> kBsdfReadingNames = {"clear", "reflection"};

/// What a scene does not need and is not given. Each can be switched off, to see what it saves.
struct Savings {
  bool background = true;       ///< pixels without the object: a few samples of the environment
  bool shared_paths = true;     ///< one set of unscattered paths for the full and the pure-BSDF image
  bool parts = true;            ///< with `error`: each part its own number of samples
  bool pixels = true;           ///< with `error`: each pixel its own number of samples
  bool guide = true;            ///< directions to the light learned beforehand
  bool guide_by_need = true;    ///< .. unless light comes from everywhere
  bool light_paths = true;      ///< scattered light traced from its source, where there is a guide
  bool bounded_queries = true;  ///< queries end where the free flight does
  bool even_samples = true;     ///< a low-discrepancy sequence over a pixel's samples
};

struct RenderOptions {
  int64_t spp =
      32;  ///< samples a pixel; with `error` the least number of unscattered ones, for the pure-BSDF image
  /// Over 0: instead of `spp`, as many samples as bring the standard error of S0 over the object, root mean
  /// square over its pixels, to this share of its mean there (light over white, S0 = 2, counts as white).
  double error = 0.0;
  double dop_error = 0.0;  ///< over 0: .. and that of the degree of polarisation to this
  int64_t pilot = 8;       ///< samples a pixel that `error` is planned from
  int64_t most = 1 << 16;  ///< samples of a part of a pixel
  BsdfReading bsdf = BsdfReading::kClear;
  /// Light sub-paths of the guide; 0: about as many as camera paths, up to what a cell can make use of.
  int64_t photons = 0;
  Savings savings{};
  uint64_t seed = 0;
  uint32_t number = 0;
};

/// Renders the scene with all threads, or with the calling thread inside a parallel region. Bitwise the same
/// for any number of them: each pixel has its own streams.
SceneRender render_scene(const SceneModel& scene, const Camera& camera, const RenderOptions& options);

/// Whether the object covers at least one whole pixel and none at the image's border.
bool well_framed(const std::vector<float>& coverage, int width, int height);

}  // namespace opaline::render
