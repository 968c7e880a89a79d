#include "data/render/medium.h"

#include <limits>
#include <numbers>

namespace opaline::render {

double henyey_greenstein(double cosine, double g) {
  const double base = std::max(1.0 + g * g - 2.0 * g * cosine, 1e-300);
  return (1.0 - g * g) / (4.0 * std::numbers::pi * base * std::sqrt(base));
}

double sample_henyey_greenstein(double u, double g) {
  // The usual inversion, with the factor g cancelled by hand: no special case, no loss of digits at small g.
  const double s = 2.0 * u - 1.0;
  const double a = 1.0 + g * s;
  const double cosine =
      (2.0 * s + g * (s * s + 3.0) + 2.0 * g * g * s + g * g * g * (s * s - 1.0)) / (2.0 * a * a);
  return std::clamp(cosine, -1.0, 1.0);
}

SpectralFlight::SpectralFlight(const Medium& medium, const Rgb& beta) : medium_(&medium) {
  const double scale = 1.0 / (beta[0] + beta[1] + beta[2]);
  share_ = {beta[0] * scale, beta[1] * scale, beta[2] * scale};
}

double SpectralFlight::sample(double choose, double u) const {
  const size_t channel = choose < share_[0] ? 0 : (choose < share_[0] + share_[1] ? 1 : 2);
  const double sigma = medium_->sigma_t[channel];
  return sigma > 0.0 ? -std::log1p(-u) / sigma : std::numeric_limits<double>::infinity();
}

void SpectralFlight::collide(double distance, Rgb& beta) const {
  Rgb density = medium_->transmittance(distance);
  for (size_t c = 0; c < 3; ++c) density[c] *= medium_->sigma_t[c];
  const double scale = 1.0 / survival(density);
  for (size_t c = 0; c < 3; ++c) beta[c] *= density[c] * scale;
}

double SpectralFlight::arrive(double distance, Rgb& beta) const {
  const Rgb transmittance = medium_->transmittance(distance);
  const double probability = survival(transmittance);
  for (size_t c = 0; c < 3; ++c) beta[c] *= transmittance[c] / probability;
  return probability;
}

}  // namespace opaline::render
