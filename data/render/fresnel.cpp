#include "data/render/fresnel.h"

#include <algorithm>
#include <cmath>

namespace opaline::render {

Fresnel fresnel(double cos_incidence, double eta) {
  // At exactly grazing incidence between equal indices the quotients below would be 0 / 0.
  const double ci = std::clamp(cos_incidence, 1e-12, 1.0);
  // Squared cosine of the refracted ray, from Snell's law, in a form that keeps its sign near grazing
  // incidence.
  const double transmit2 = ((eta * eta - 1.0) + ci * ci) / (eta * eta);
  Fresnel f;
  if (transmit2 > 0.0) {
    const double ct = std::sqrt(transmit2);
    const double rs = (ci - eta * ct) / (ci + eta * ct);
    const double rp = (eta * ci - ct) / (eta * ci + ct);
    f.reflect_s = rs * rs;
    f.reflect_p = rp * rp;
    f.cross_real = rs * rp;
    f.cos_transmit = ct;
    return f;
  }
  // Total reflection: the refracted cosine is i kappa, both coefficients have modulus 1, and
  // r_s conj(r_p) = w^2 / |w|^2 with w = (ci - i eta kappa) (eta ci + i kappa).
  const double kappa = std::sqrt(-transmit2);
  const double re = eta * (ci * ci + kappa * kappa);
  const double im = kappa * ci * (1.0 - eta * eta);
  const double modulus2 = re * re + im * im;
  f.total = true;
  f.reflect_s = f.reflect_p = 1.0;
  f.cross_real = (re * re - im * im) / modulus2;
  f.cross_imag = 2.0 * re * im / modulus2;
  return f;
}

double diffuse_reflectance(double eta) {
  // From inside by way of outside: etendue is kept, so 1 - F_in = (1 - F_out) eta^2.
  if (eta < 1.0) return 1.0 - (1.0 - diffuse_reflectance(1.0 / eta)) * eta * eta;
  // 2 integral of R(c) c dc over [0, 1]; c = t^2 smooths the grazing end. Simpson's rule.
  constexpr int kIntervals = 4000;
  double sum = 0.0;
  for (int i = 0; i <= kIntervals; ++i) {
    const double t = static_cast<double>(i) / kIntervals;
    const double weight = i == 0 || i == kIntervals ? 1.0 : (i % 2 == 1 ? 4.0 : 2.0);
    sum += weight * fresnel(t * t, eta).reflectance() * 4.0 * t * t * t;
  }
  return sum / (3.0 * kIntervals);
}

double specular_dop(double angle, double n) {
  const double s2 = std::sin(angle) * std::sin(angle);
  const double n2 = n * n;
  return 2.0 * s2 * std::cos(angle) * std::sqrt(n2 - s2) / (n2 - s2 - n2 * s2 + 2.0 * s2 * s2);
}

double diffuse_dop(double angle, double n) {
  const double s2 = std::sin(angle) * std::sin(angle);
  const double minus = n - 1.0 / n, plus = n + 1.0 / n;
  return minus * minus * s2 /
         (2.0 + 2.0 * n * n - plus * plus * s2 + 4.0 * std::cos(angle) * std::sqrt(n * n - s2));
}

}  // namespace opaline::render
