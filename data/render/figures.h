// Figures of the renderer's parts that are known in closed form: the phase function, spherical harmonics, the
// flash.
#pragma once

#include <cstdint>
#include <vector>

#include "data/render/validate.h"

namespace opaline::render {

/// Directions drawn as the walk draws them, stratified in each block: their mean cosine is g, their second
/// Legendre moment g^2; the same moments by the density that steers multiple importance sampling, and its
/// integral. Throws UsageError where |g| is not below 1.
std::vector<Figure> validate_hg(double g, int64_t paths = 1'000'000, uint64_t seed = 1);

/// Environments through Environment::project: radiance 1, max(0, z), and max(0, cosine) around `rotations`
/// random axes, whose bands keep their norms.
std::vector<Figure> validate_sh(int rotations = 4, uint64_t seed = 1);

/// The irradiance of a plane at d = 0.8 m from a flash of radius 0.1 m and radiance 50, pi L (r/d)^2: by the
/// formula; by directions over the hemisphere; and through the whole path tracer, as the radiance of a half-
/// space of index 1, albedo 0.9 and isotropic scattering, whose BRDF Chandrasekhar's H gives.
std::vector<Figure> validate_flash(int64_t paths = 8'000'000, uint64_t seed = 1);

/// Chandrasekhar's H function for isotropic scattering, by iteration to 1e-12; cosine in [0, 1], albedo in
/// [0, 1).
class ChandrasekharH {
 public:
  explicit ChandrasekharH(double albedo);
  double operator()(double cosine) const;
  /// a / (4 pi) H(mu) H(mu0) / (mu + mu0).
  double brdf(double cosine_in, double cosine_out) const;

 private:
  double albedo_;
  std::vector<double> cosines_, weights_, values_;
};

}  // namespace opaline::render
