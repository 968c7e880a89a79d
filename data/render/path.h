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

#include "core/random.h"
#include "data/render/fresnel.h"
#include "data/render/geometry.h"
#include "data/render/guide.h"
#include "data/render/light.h"
#include "data/render/medium.h"

namespace opaline::render {

/// What a path may meet. The pointers must outlive it.
struct World {
  const Geometry* geometry = nullptr;
  const Light* light = nullptr;
  Medium medium{};
  double index = kRefractiveIndex;
  const Guide* guide = nullptr;  ///< null: phase function alone
  /// Queries inside the medium end where the free flight does; else they look for the surface and compare.
  bool bounded_queries = true;
};

/// Parts of a sample, which can be estimated one by one and as often as each deserves.
struct PathParts {
  bool mirror = true;  ///< reflected where the ray meets the object, if nothing is in the way after that
  bool unscattered =
      true;  ///< the rest of the light that does not scatter: through the body, or reflected twice
  bool scattered = true;
};

/// The first random numbers of scattered paths, in [0, 1): a low-discrepancy sequence over a pixel's samples
/// can take their place.
struct FirstNumbers {
  double channel = 0;   ///< chooses the colour whose free flight is drawn
  double distance = 0;  ///< draws that flight
  double light = 0;     ///< chooses the guide's bin of directions
};

/// S0, S1, S2 in each colour.
using StokesRgb = std::array<Rgb, 3>;

struct CameraRay {
  Vec3 origin;
  Vec3 direction;  ///< unit
  Vec3 axis;       ///< unit, across `direction`: 0 degrees of the polariser
};

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

/// Paths that numerical errors cut short: a ray inside the closed surface that met nothing, or met it from
/// the wrong side.
struct PathFaults {
  int64_t lost = 0;
  int64_t paths = 0;
};

PathSample sample_path(const World& world, const CameraRay& ray, Random& random, PathFaults& faults);
/// Some parts of it, from these first numbers; the rest is zero.
PathSample sample_path_parts(const World& world, const CameraRay& ray, const PathParts& parts,
                             const FirstNumbers& first, Random& random, PathFaults& faults);

/// The unit direction of the ray that the surface reflects, and of the one that it refracts.
Vec3 reflect(const Vec3& direction, const Vec3& normal);
/// `normal` towards the side that `direction` comes from, `eta` = index behind / index before.
Vec3 refract(const Vec3& direction, const Vec3& normal, const Fresnel& f, double eta);

}  // namespace opaline::render
