// Plane-parallel radiative transfer without chance: the adding-doubling method in double precision (van de
// Hulst; Prahl, van Gemert and Welch 1993), for layers of index 1 and Henyey-Greenstein scattering.
#pragma once

#include <Eigen/Dense>
#include <cmath>
#include <numbers>
#include <vector>

#include "data/render/medium.h"

namespace opaline::render {

struct LayerFluxes {
  double reflected = 0;    ///< share of the incident flux
  double transmitted = 0;  ///< unscattered light included
};

class AddingDoubling {
 public:
  /// `nodes` Gauss points in the cosine, and the normal direction as one more of no weight.
  AddingDoubling(double albedo, double g, double tau, int nodes = 32) {
    gauss(nodes);
    cosine_.push_back(1.0);
    weight_.push_back(0.0);
    const auto n = static_cast<Eigen::Index>(cosine_.size());
    Eigen::MatrixXd forward(n, n), backward(n, n);
    for (Eigen::Index i = 0; i < n; ++i) {
      for (Eigen::Index j = 0; j < n; ++j) {
        forward(i, j) = azimuthal_mean(at(cosine_, i), at(cosine_, j), g);
        backward(i, j) = azimuthal_mean(at(cosine_, i), -at(cosine_, j), g);
      }
    }
    // What quadrature misses of a peaked phase function goes straight on.
    const Eigen::VectorXd w = Eigen::Map<const Eigen::VectorXd>(weight_.data(), n);
    for (Eigen::Index j = 0; j < n; ++j) {
      const double sum = 0.5 * (forward.col(j) + backward.col(j)).dot(w);
      if (at(weight_, j) > 0.0) {
        forward(j, j) += (1.0 - sum) / (0.5 * at(weight_, j));
      } else {
        forward.col(j) /= sum;
        backward.col(j) /= sum;
      }
    }
    // A layer so thin that light scatters once at most, doubled. Matrices act on radiances from the right;
    // column j holds what unit flux density in the beam j makes.
    int doublings = 0;
    double thin = tau;
    for (; thin > 1e-9; thin *= 0.5) ++doublings;
    Eigen::MatrixXd r(n, n), t(n, n);
    for (Eigen::Index i = 0; i < n; ++i) {
      for (Eigen::Index j = 0; j < n; ++j) {
        const double single = 0.5 * albedo * thin / at(cosine_, i) * at(weight_, j);
        r(i, j) = single * backward(i, j);
        t(i, j) = single * forward(i, j);
      }
      t(i, i) += 1.0 - thin / at(cosine_, i);
    }
    // The normal direction scatters into others but, having no weight, gets nothing from them as a source:
    // its incident beam is followed by a vector of its own.
    Eigen::VectorXd up(n), down(n);
    const Eigen::Index last = n - 1;
    double direct = 1.0 - thin;
    for (Eigen::Index i = 0; i < n; ++i) {
      up(i) = albedo * thin / at(cosine_, i) * backward(i, last) / (4.0 * std::numbers::pi);
      down(i) = albedo * thin / at(cosine_, i) * forward(i, last) / (4.0 * std::numbers::pi);
    }
    const Eigen::MatrixXd one = Eigen::MatrixXd::Identity(n, n);
    for (int k = 0; k < doublings; ++k) {
      const Eigen::PartialPivLU<Eigen::MatrixXd> many(one - r * r);
      // Between the halves: light going down, then up.
      const Eigen::VectorXd middle_down = many.solve(down + r * (direct * up));
      const Eigen::VectorXd middle_up = r * middle_down + direct * up;
      const Eigen::VectorXd whole_up = up + t * middle_up;
      const Eigen::VectorXd whole_down = direct * down + t * middle_down;
      up = whole_up;
      down = whole_down;
      direct *= direct;
      const Eigen::MatrixXd inner = many.solve(t);
      r = r + t * r * inner;
      t = t * inner;
    }
    for (Eigen::Index i = 0; i < n; ++i) {
      const double flux = 2.0 * std::numbers::pi * at(cosine_, i) * at(weight_, i);
      normal_.reflected += flux * up(i);
      normal_.transmitted += flux * down(i);
    }
    normal_.transmitted += direct;
    // Diffuse light: radiance 1 / pi carries flux 1.
    const Eigen::VectorXd diffuse = Eigen::VectorXd::Ones(n) / std::numbers::pi;
    const Eigen::VectorXd out_up = r * diffuse, out_down = t * diffuse;
    for (Eigen::Index i = 0; i < n; ++i) {
      const double flux = 2.0 * std::numbers::pi * at(cosine_, i) * at(weight_, i);
      diffuse_.reflected += flux * out_up(i);
      diffuse_.transmitted += flux * out_down(i);
    }
  }

  LayerFluxes normal() const { return normal_; }
  LayerFluxes diffuse() const { return diffuse_; }

 private:
  static double at(const std::vector<double>& v, Eigen::Index i) { return v[static_cast<size_t>(i)]; }

  /// 4 pi times the phase function, averaged over azimuth.
  static double azimuthal_mean(double mu, double nu, double g) {
    constexpr int kSteps = 2000;
    const double across = std::sqrt((1.0 - mu * mu) * (1.0 - nu * nu));
    double sum = 0.0;
    for (int k = 0; k < kSteps; ++k) {
      const double cosine = mu * nu + across * std::cos(std::numbers::pi * (k + 0.5) / kSteps);
      sum += henyey_greenstein(cosine, g);
    }
    return 4.0 * std::numbers::pi * sum / kSteps;
  }

  /// Gauss-Legendre points on (0, 1), by Newton's method.
  void gauss(int n) {
    for (int i = 0; i < n; ++i) {
      double x = std::cos(std::numbers::pi * (i + 0.75) / (n + 0.5)), slope = 1.0;
      for (int step = 0; step < 50; ++step) {
        double p0 = 1.0, p1 = x;
        for (int k = 2; k <= n; ++k) {
          const double p2 = ((2.0 * k - 1.0) * x * p1 - (k - 1.0) * p0) / k;
          p0 = p1;
          p1 = p2;
        }
        slope = n * (x * p1 - p0) / (x * x - 1.0);
        x -= p1 / slope;
      }
      cosine_.push_back(0.5 * (1.0 + x));
      weight_.push_back(1.0 / ((1.0 - x * x) * slope * slope));
    }
  }

  std::vector<double> cosine_, weight_;
  LayerFluxes normal_, diffuse_;
};

}  // namespace opaline::render
