// The path tracer: Monte Carlo estimates of the Stokes vector that reaches the camera along one ray.
//
// Paths start at the camera. At the first surface point they split: what is reflected and what is refracted
// in are both followed. Light that never scatters (the clear dielectric's) is one estimate, which with and
// without the medium's extinction gives the full image's unscattered part and the pure-BSDF image; light that
// scatters at least once is the other. Inside, one walk serves the three colours (data/render/medium.h), and
// at each scattering a second direction is drawn from the guide (data/render/guide.h). Neither depth nor
// brightness is capped; roulette divides by its probability.
//
// Each path that enters the medium from outside leaves it, so the factors n^2 of radiance at refractions
// cancel and are left out.
#pragma once

#include <array>
#include <cstdint>

#include "data/render/camera.h"
#include "data/render/walk.h"

namespace opaline::render {

/// Parts of a sample, which can be estimated one by one and as often as each deserves.
struct PathParts {
  bool mirror = true;  ///< reflected where the ray meets the object, if nothing is in the way after that
  bool unscattered =
      true;  ///< the rest of the light that does not scatter: through the body, or reflected twice
  bool scattered = true;
  /// Scattered light with what the camera sees straight through the surface, which light paths can give
  /// instead (data/render/light_paths.h).
  bool direct = true;
};

/// S0, S1, S2 in each colour.
using StokesRgb = std::array<Rgb, 3>;

/// One sample of everything that a pixel wants to know.
struct PathSample {
  bool hit = false;  ///< of the object; otherwise `background` alone is set
  Vec3 position;
  Vec3 normal;
  Rgb background{};

  StokesRgb reflected{};    ///< not scattered, first event a reflection
  StokesRgb unscattered{};  ///< not scattered, first event a refraction
  StokesRgb scattered{};    ///< scattered at least once
  StokesRgb clear{};        ///< without the medium, both first events: the pure-BSDF image
  StokesRgb mirror{};       ///< reflected on the outside only: the other reading of "pure BSDF"
};

PathSample sample_path(const World& world, const CameraRay& ray, Random& random, PathFaults& faults);
/// Some parts of it, from these first numbers; the rest is zero.
PathSample sample_path_parts(const World& world, const CameraRay& ray, const PathParts& parts,
                             const FirstNumbers& first, Random& random, PathFaults& faults);

}  // namespace opaline::render
