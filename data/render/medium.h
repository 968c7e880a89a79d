// A homogeneous participating medium with a Henyey-Greenstein phase function, walked for three colour
// channels at once.
#pragma once

#include <algorithm>
#include <cmath>

#include "data/render/vec3.h"

namespace opaline::render {

struct Medium {
  Rgb sigma_t{};  ///< extinction, per metre
  Rgb albedo{};   ///< scattering / extinction
  double g = 0;   ///< mean cosine of scattering

  bool empty() const { return !(std::max({sigma_t[0], sigma_t[1], sigma_t[2]}) > 0.0); }
  Rgb transmittance(double distance) const {
    return {std::exp(-sigma_t[0] * distance), std::exp(-sigma_t[1] * distance),
            std::exp(-sigma_t[2] * distance)};
  }
};

/// Henyey-Greenstein phase function, per steradian; `cosine` 1 is straight on.
double henyey_greenstein(double cosine, double g);
/// A cosine with that density, from u in [0, 1). Exact for every |g| < 1, small ones included.
double sample_henyey_greenstein(double u, double g);

/// Free flights of a path whose channels have throughputs `beta`. The channel that a distance is drawn from
/// is chosen with probability proportional to its throughput, and the density is the mean over channels so
/// weighted: with equal albedos that is the balance heuristic over channels of the whole path's density
/// (spectral multiple importance sampling), and the sum of the throughputs has no variance.
class SpectralFlight {
 public:
  SpectralFlight(const Medium& medium, const Rgb& beta);

  /// A distance, from two numbers in [0, 1); infinity where the chosen channel has no medium.
  double sample(double choose, double u) const;
  /// Probability of flying farther than `distance`.
  double survival(const Rgb& transmittance) const {
    return share_[0] * transmittance[0] + share_[1] * transmittance[1] + share_[2] * transmittance[2];
  }
  /// Updates `beta` for a flight that ended in the medium, before the albedo.
  void collide(double distance, Rgb& beta) const;
  /// Updates `beta` for a flight that reached the surface; returns the probability of that.
  double arrive(double distance, Rgb& beta) const;

 private:
  const Medium* medium_;
  Rgb share_;
};

}  // namespace opaline::render
