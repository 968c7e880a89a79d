// Even samples.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <cstdint>

#include "core/random.h"

namespace opaline::render {

/// Independent numbers in [0, 1).
template <size_t D>
std::array<double, D> uniform(Random& random) {
  std::array<double, D> x;
  for (double& value : x) value = random.uniform();
  return x;
}

/// Points in the unit cube: multiples of powers of 1 / phi, phi^(D + 1) = phi + 1 (Roberts, "The unreasonable
/// effectiveness of quasirandom sequences", 2018), shifted at random. Each point alone is uniform, together
/// they are even.
template <size_t D>
class Sequence {
 public:
  explicit Sequence(Random& random) {
    double phi = 1.5;
    for (int i = 0; i < 64; ++i) phi = std::pow(1.0 + phi, 1.0 / (D + 1.0));
    double step = 1.0;
    for (size_t i = 0; i < D; ++i) {
      step_[i] = step /= phi;
      shift_[i] = random.uniform();
    }
  }

  std::array<double, D> at(int64_t index) const {
    std::array<double, D> x;
    for (size_t i = 0; i < D; ++i) {
      const double value = shift_[i] + step_[i] * static_cast<double>(index);
      x[i] = value - std::floor(value);
    }
    return x;
  }

 private:
  std::array<double, D> step_{}, shift_{};
};

}  // namespace opaline::render
