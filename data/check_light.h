// What light tells about the conventions it is stored in: whether the four images fit together, their gamma,
// the signs of s1 and s2.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>

#include "data/check_frame.h"
#include "data/scene.h"
#include "data/stored_light.h"

namespace opaline {

/// How well I45 + I135 = I0 + I90 holds, before anything is equalised. Over well-exposed values of the
/// object.
struct PairCheck {
  int64_t values = 0;
  double ratio = 1;  ///< median of (I45 + I135) / (I0 + I90)
  double rms = 0;    ///< root mean square of that quotient less one
  /// Median deviation of the quotient from its median, of each way to pair the four images: {0, 90}, {0, 45}
  /// and {0, 135} against the others. The right one is the smallest where light is polarised.
  std::array<double, 3> spread{};
  double saturated = 0;  ///< share of the object's values that the sensor may have clipped
};
PairCheck check_pairs(const PolariserImages& images, const std::vector<uint8_t>& mask);

/// The gamma under which I0 + I90 = I45 + I135 holds. Decoded with another exponent, both sums are off by the
/// square of their difference: (I45 + I135) / (I0 + I90) = 1 + k (b^2 - a^2) with a = s1 / s0, b = s2 / s0,
/// and k = 0 for the right one. A gain between the pairs is a constant, which does not matter. Sums over
/// scenes, for a grid of exponents; sums add up.
struct GammaEvidence {
  static constexpr size_t kCount = 9;
  std::array<double, kCount> xx{};  ///< of b^2 - a^2 around its mean
  std::array<double, kCount> xy{};
  std::array<double, kCount> yy{};
  double values = 0;
  /// Logarithms of s0.npy against those of the images' s0: slope 1 where the images' gamma is as declared.
  double log_xx = 0;
  double log_xy = 0;

  GammaEvidence& operator+=(const GammaEvidence& other);
};
GammaEvidence gamma_evidence(const StoredLight& light, const std::vector<uint8_t>& mask);

/// What readers of 8-bit images decode with.
inline constexpr double kDeclaredGamma = 2.2;
struct GammaMatch {
  bool known = false;
  double gamma = 0;                      ///< estimate by the four images; 0 without evidence
  double error = 0;                      ///< of it, one standard deviation
  std::optional<double> by_stokes = {};  ///< estimate by s0.npy
  /// Nothing speaks against the declared one.
  bool agrees() const;
};
GammaMatch match_gamma(const GammaEvidence& evidence);
/// "2.23 +- 0.04 by the four images, 2.20 by s0.npy".
std::string to_string(const GammaMatch& match);

/// Sums that tell how the polarisation (s1, s2) / s0 lies to a direction phi in the image: along or across it
/// in the right convention, whichever of the two. `along` counts 2 s1 s2 sin 4phi, `square` (s1^2 - s2^2)
/// cos 4phi, both divided by their largest value: where the polarisation is along or across phi both are
/// positive, with one sign flipped `along` is negative, with angles 45 degrees off `square` is.
struct Orientation {
  double weight = 0;  ///< mean DoP
  double along = 0;   ///< times weight
  double square = 0;
  double along_variance = 0;  ///< times weight^2
  double square_variance = 0;

  Orientation& operator+=(const Orientation& other);
};

/// Evidence for the signs of s1 and s2; sums add up.
struct SignEvidence {
  Orientation edge;    ///< phi: out of the object, at silhouettes
  Orientation normal;  ///< phi: the normal's, where there is one
  /// Where light has mostly scattered inside of the object (the pure-BSDF image is dark) its polarisation
  /// lies along the normal: sums of s1 cos 2phi / s0, s2 sin 2phi / s0, DoP and pixels at silhouettes.
  double radial_1 = 0;
  double radial_2 = 0;
  double radial_length = 0;
  double radial_pixels = 0;
  /// Both together, of all pixels at silhouettes, reflections among them.
  double edge_radial = 0;
  double edge_length = 0;

  SignEvidence& operator+=(const SignEvidence& other);
};
SignEvidence sign_evidence(const Scene& scene);

struct SignMatch {
  bool known = false;     ///< s1 against s2
  bool turned = false;    ///< polarisers' angles are 45 degrees off
  bool mirrored = false;  ///< one of the two signs is wrong
  bool polarity = false;  ///< `flip_1` and `flip_2` are known
  bool flip_1 = false;    ///< s1 has the wrong sign
  bool flip_2 = false;    ///< s2 has
  double along = 0;       ///< means of Orientation
  double square = 0;
  double radial = 0;       ///< from -1 (across the normal) to 1 (along), of scattered light
  double edge_radial = 0;  ///< likewise, of all light at silhouettes
  bool agrees() const { return !turned && !mirrored && !(polarity && (flip_1 || flip_2)); }
};
/// `frame` tells which way the normals' axes point.
SignMatch match_signs(const SignEvidence& evidence, const FrameMatch& frame);
std::string to_string(const SignMatch& match);

}  // namespace opaline
