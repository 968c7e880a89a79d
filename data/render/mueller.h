// How the polariser behind a pixel sees light that arrives at the far end of a path.
//
// Paths are traced from the camera, so instead of a Stokes vector they carry rows: row i dotted with the
// Stokes vector of the light that would arrive along the path's last ray gives Stokes component i at the
// pixel. A surface event multiplies the rows by its 4 x 4 Mueller matrix from the right.
//
// Frames. The Stokes vector of light that travels along k refers to an axis X perpendicular to k and to
// Y = k x X: S1 = I(X) - I(Y), S2 = I(X + Y) - I(X - Y). Looking into the beam with X to the right, angles
// run counter-clockwise. After an event X is normal to its plane of incidence.
//
// Depolarisation. Light that has scattered at least once carries S0 alone while it is inside: M_d acts at the
// exit, and what happens inside after the first scattering is scalar. Light that never scattered keeps its
// whole Stokes vector. A path under construction does not know yet which of the two it will meet, so it
// carries rows for both: `pure` and `scattered` (inside, only the first column of the latter is in use).
#pragma once

#include <array>

#include "data/render/fresnel.h"
#include "data/render/vec3.h"

namespace opaline::render {

using Stokes = std::array<double, 4>;
using Mueller = std::array<std::array<double, 4>, 4>;

/// From the frame of axis X to the frame whose axis is turned by `angle` from X towards Y.
Mueller frame_rotation(double angle);
/// Reflection and transmission (power) in frames normal to the plane of incidence.
Mueller reflection(const Fresnel& f);
Mueller transmission(const Fresnel& f);
/// S0 alone passes.
Mueller depolariser();
Mueller product(const Mueller& a, const Mueller& b);
Stokes apply(const Mueller& m, const Stokes& s);

/// An event on the surface, as seen by a path that is traced from the camera.
struct SurfaceEvent {
  Vec3 direction;  ///< of the path before the event; light travels against it
  Vec3 normal;     ///< either orientation
  Fresnel fresnel;
  /// What the rows are multiplied by besides the matrix: 1 / probability of this branch.
  double weight = 1.0;
  bool inside = false;  ///< the path arrives from inside
};

/// Rows of R Stokes components (see above).
template <int R>
struct Response {
  std::array<Stokes, R> pure{};
  std::array<Stokes, R> scattered{};
  Vec3 axis;  ///< X of the frame of the path's last ray

  void reflect(const SurfaceEvent& event);
  void transmit(const SurfaceEvent& event);
};

extern template struct Response<1>;
extern template struct Response<3>;

/// Of a camera whose polariser's 0 degrees are along `axis`: S0, S1 and S2 as they arrive.
Response<3> camera_response(const Vec3& axis);
/// Of unpolarised light that goes on along the unit vector `direction`.
Response<1> scalar_response(const Vec3& direction);
/// What the rows make of unpolarised light.
std::array<double, 3> first_column(const std::array<Stokes, 3>& rows);

}  // namespace opaline::render
