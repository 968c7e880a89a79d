// Known answers, through the code that renders.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "data/render/scene.h"

namespace opaline::render {

/// A Monte Carlo mean and its standard error.
struct Estimate {
  double mean = 0;
  double standard_error = 0;
};

struct SlabOptions {
  double albedo = 0.9;
  double g = 0.0;
  double tau = kInfinity;  ///< optical thickness; infinite: a half-space
  double index = 1.0;
  bool lambertian = false;  ///< diffuse incidence; else normal
  int64_t paths = 1'000'000;
  uint64_t seed = 1;
};

struct SlabResult {
  Estimate reflected;    ///< Rd: diffuse reflectance, without what the first surface reflects
  Estimate transmitted;  ///< T: what leaves on the other side, unscattered light included
  double specular = 0;   ///< reflected by the first surface
  double paths_per_second = 0;
};

/// Reflectance and transmittance of a layer. By reciprocity they are what a camera sees whose ray arrives
/// from the incident direction, with light of radiance 1 above (Rd) or below (T) the layer. Throws UsageError
/// on values out of range, and on a half-space that absorbs nothing (its paths have infinite mean length).
SlabResult validate_slab(const SlabOptions& options);

struct FurnaceOptions {
  int64_t paths =
      400'000;  ///< of each scene, over rays that meet the object; six times as many without the medium
  uint64_t seed = 1;
  uint32_t number = 0;  ///< of the scene
};

/// The light from the object where the environment and the flash have radiance 1 and nothing is absorbed. S0
/// is 1 for any shape and medium. Without the medium S1 and S2 are 0; they are in the frame of each surface
/// point, along and across its plane of incidence, where errors cannot cancel between sides of the object.
/// With a medium that light crosses unscattered S1 and S2 are not exactly 0: where such light enters on the
/// far side it is polarised by refraction, and the scattered light that is reflected there, which would
/// complement it, has lost its polarisation by the definition of M_d.
struct FurnaceResult {
  std::string object;
  Estimate s0;                    ///< of the full image
  std::array<Estimate, 3> clear;  ///< S0, S1, S2 without the medium
  /// S0 of the full image by the cosine between surface and ray: [0, 1/4), [1/4, 1/2), ..
  std::array<Estimate, 4> by_cosine;
  PathFaults faults;
};
FurnaceResult validate_furnace(const SceneRanges& ranges, const FurnaceOptions& options);

/// One figure with what it should be; `standard_error` 0 for figures that are computed without chance, whose
/// tolerance is then half a unit of the expectation's last digit.
struct Figure {
  std::string name;
  double value = 0;
  double standard_error = 0;
  double expected = 0;
  double tolerance = 0;

  bool passes() const;
};

/// The Fresnel table: reflectances and degrees of polarisation of specular and diffuse light at five angles,
/// Brewster's and the critical angle, average reflectances on both sides.
std::vector<Figure> validate_fresnel(int64_t paths = 1'000'000, uint64_t seed = 1);

}  // namespace opaline::render
