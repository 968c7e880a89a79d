// Winograd's minimal filtering F(m x m, 3 x 3) from its interpolation points (Lavin and Gray, CVPR 2016; the
// construction of Cook and Toom: Winograd, Arithmetic Complexity of Computations, 1980). With
// M(x) = x prod_i (x^2 - p_i^2), of degree m + 1, a row of m outputs of a 3-tap correlation is
//   y = A^T [(G g) . (B^T d)],
// where row p of B^T has the coefficients of M(x) / (x - p), row p of G is (1, p, p^2) / N_p with
// N_p = prod_{q != p} (p - q), row p of A is (1, p, .., p^(m-1)), and infinity contributes M itself, the last
// tap and the last power. Points come in pairs p and -p: their rows are sum and difference of an even and an
// odd part, which halves the work. The points of F(m, 3) serve F(m + 3 - r, r) as well: A and G have as many
// powers as there are outputs and taps, B is the same.
#pragma once

#include <array>

namespace opaline::kernels {

/// The positive points. m = 4 takes sqrt(1/2) and sqrt(2), whose powers stay closer to one than those of the
/// usual 1 and 2: a third of the error.
template <int kOutputs>
constexpr std::array<double, kOutputs / 2> winograd_points() {
  static_assert(kOutputs == 2 || kOutputs == 4 || kOutputs == 6);
  if constexpr (kOutputs == 2) return {1.0};
  if constexpr (kOutputs == 4) return {0.70710678118654752440, 1.41421356237309504880};
  if constexpr (kOutputs == 6) return {1.0, 0.5, 2.0};
}

template <int kOutputs>
struct Winograd {
  static constexpr int kPairs = kOutputs / 2;
  static constexpr int kTile = kOutputs + 2;
  static constexpr std::array<double, kPairs> kPoints = winograd_points<kOutputs>();

  /// p_i^k.
  static constexpr double power(int i, int k) {
    double result = 1.0;
    for (int j = 0; j < k; ++j) result *= kPoints[static_cast<size_t>(i)];
    return result;
  }

  using Coefficients = std::array<double, kPairs + 1>;
  /// Coefficients, lowest first, of prod over j != skip of (t - p_j^2); skip = -1 for all of them.
  static constexpr Coefficients product(int skip) {
    Coefficients c{};
    c[0] = 1.0;
    int degree = 0;
    for (int j = 0; j < kPairs; ++j) {
      if (j == skip) continue;
      ++degree;
      for (int k = degree; k >= 0; --k) {
        const auto at = static_cast<size_t>(k);
        c[at] = (k > 0 ? c[at - 1] : 0.0) - power(j, 2) * c[at];
      }
    }
    return c;
  }

  /// 1 / N_0 and 1 / N_p of pair i, the same for p and -p.
  static constexpr double zero_weight() { return 1.0 / product(-1)[0]; }
  static constexpr double pair_weight(int i) {
    double n = 2.0 * power(i, 2);
    for (int j = 0; j < kPairs; ++j) {
      if (j != i) n *= power(i, 2) - power(j, 2);
    }
    return 1.0 / n;
  }
};

}  // namespace opaline::kernels
