#include "data/check_light.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>

namespace opaline {
namespace {

// Linear light of level 20 of 255, under which 8 bits tell too little of a ratio.
const double kDark = std::pow(20.0 / 255.0, kDeclaredGamma);

/// Values of the object in which none of the four images is dark or clipped.
std::vector<size_t> well_exposed(const PolariserImages& images, const std::vector<uint8_t>& mask) {
  std::vector<size_t> found;
  const auto& [i0, i45, i90, i135] = images.images;
  for (size_t i = 0; i < i0.size(); ++i) {
    if (mask[i / 3] == 0 || images.clipped[i] != 0) continue;
    if (static_cast<double>(std::min({i0[i], i45[i], i90[i], i135[i]})) >= kDark) found.push_back(i);
  }
  return found;
}

double median(std::vector<double> values) {
  if (values.empty()) return 0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

double median_deviation(const std::vector<double>& values, double centre) {
  std::vector<double> deviations;
  deviations.reserve(values.size());
  for (const double value : values) deviations.push_back(std::abs(value - centre));
  return median(std::move(deviations));
}

/// (c + d) / (a + b) - 1 of four images at the given values.
std::vector<double> mismatch(const PolariserImages& images, const std::vector<size_t>& at,
                             const std::array<size_t, 4>& order) {
  std::vector<double> result;
  result.reserve(at.size());
  for (const size_t i : at) {
    std::array<double, 4> v{};
    for (size_t k = 0; k < 4; ++k) v[k] = static_cast<double>(images.images[order[k]][i]);
    result.push_back((v[2] + v[3]) / (v[0] + v[1]) - 1);
  }
  return result;
}

/// Moments of y against x around their means.
struct Moments {
  double n = 0, x = 0, y = 0, xx = 0, xy = 0, yy = 0;
  void add(double a, double b) {
    n += 1;
    x += a;
    y += b;
    xx += a * a;
    xy += a * b;
    yy += b * b;
  }
  double centred_xx() const { return n > 0 ? std::max(0.0, xx - x * x / n) : 0; }
  double centred_xy() const { return n > 0 ? xy - x * y / n : 0; }
  double centred_yy() const { return n > 0 ? std::max(0.0, yy - y * y / n) : 0; }
};

constexpr double kFirstGamma = 1.0;
constexpr double kGammaStep = 0.25;

double grid_gamma(size_t k) {
  return kFirstGamma + kGammaStep * static_cast<double>(k);
}

/// Moments without the values that lie far off the line through most: at edges the four images do not quite
/// lie over each other, which says nothing of gamma.
Moments trimmed_moments(const std::vector<double>& x, const std::vector<double>& y) {
  Moments m;
  for (size_t i = 0; i < x.size(); ++i) m.add(x[i], y[i]);
  constexpr int kRounds = 2;
  constexpr double kFar = 6;  // median deviations
  std::vector<double> off(x.size());
  for (int round = 0; round < kRounds && m.n > 0; ++round) {
    const double slope = m.centred_xx() > 0 ? m.centred_xy() / m.centred_xx() : 0;
    const double at_zero = (m.y - slope * m.x) / m.n;
    for (size_t i = 0; i < x.size(); ++i) off[i] = std::abs(y[i] - at_zero - slope * x[i]);
    const double limit = kFar * std::max(1e-3, median(off));
    m = {};
    for (size_t i = 0; i < x.size(); ++i) {
      if (off[i] <= limit) m.add(x[i], y[i]);
    }
  }
  return m;
}

/// Of the mismatch of the pairs against b^2 - a^2, for an exponent of the grid. `light` holds the four values
/// of each sample to the power of the grid's first exponent, `step` those to that of a step; both end where
/// the next exponent begins.
Moments gamma_moments(std::vector<std::array<double, 4>>& light,
                      const std::vector<std::array<double, 4>>& step) {
  std::vector<double> x(light.size());
  std::vector<double> y(light.size());
  for (size_t i = 0; i < light.size(); ++i) {
    std::array<double, 4>& v = light[i];
    const double first = v[0] + v[2];
    const double second = v[1] + v[3];
    const double a = (v[0] - v[2]) / first;
    const double b = (v[1] - v[3]) / second;
    x[i] = b * b - a * a;
    y[i] = second / first - 1;
    for (size_t angle = 0; angle < 4; ++angle) v[angle] *= step[i][angle];
  }
  return trimmed_moments(x, y);
}

/// Polarisation at a pixel: (s1, s2) / s0 of the three colours together.
struct Polarisation {
  double s1 = 0;
  double s2 = 0;
  double dop() const { return std::hypot(s1, s2); }
};

double sum_of_colours(const std::vector<float>& image, size_t pixel, size_t first) {
  const float* const s = image.data() + kStokesChannels * pixel + first;
  return static_cast<double>(s[0]) + static_cast<double>(s[1]) + static_cast<double>(s[2]);
}

Polarisation polarisation(const Scene& scene, size_t pixel) {
  const double s0 = sum_of_colours(scene.image, pixel, 0);
  if (!(s0 > 0)) return {};
  return {sum_of_colours(scene.image, pixel, 3) / s0, sum_of_colours(scene.image, pixel, 6) / s0};
}

/// Gathers one scene's Orientation. The spread over sixteen sectors of phi tells how sure it is: neighbours
/// are not independent, and many pixels of one bright reflection are no evidence.
class OrientationSum {
 public:
  void add(const Polarisation& p, double phi) {
    const double turn = phi / (2 * std::numbers::pi) + 1;
    Sector& sector = sectors_[static_cast<size_t>(turn * kSectors) % kSectors];
    sector.along += 2 * p.s1 * p.s2 * std::sin(4 * phi);
    sector.square += (p.s1 * p.s1 - p.s2 * p.s2) * std::cos(4 * phi);
    square_length_ += p.s1 * p.s1 + p.s2 * p.s2;
    length_ += p.dop();
    ++pixels_;
  }
  Orientation result() const {
    if (!(square_length_ > 0)) return {};
    Orientation o;
    o.weight = length_ / static_cast<double>(pixels_);
    // Both are means of a positive quantity times sin^2 or cos^2 of a uniform angle: 1/2 at most.
    const double scale = 2 / square_length_;
    double along = 0, square = 0, along_2 = 0, square_2 = 0;
    for (const Sector& s : sectors_) {
      along += scale * s.along;
      square += scale * s.square;
      along_2 += scale * scale * s.along * s.along;
      square_2 += scale * scale * s.square * s.square;
    }
    o.along = o.weight * along;
    o.square = o.weight * square;
    o.along_variance = o.weight * o.weight * (along_2 - along * along / kSectors);
    o.square_variance = o.weight * o.weight * (square_2 - square * square / kSectors);
    return o;
  }

 private:
  static constexpr size_t kSectors = 16;
  struct Sector {
    double along = 0;
    double square = 0;
  };
  std::array<Sector, kSectors> sectors_{};
  double square_length_ = 0;
  double length_ = 0;
  int64_t pixels_ = 0;
};

void add_silhouette(const Scene& scene, SignEvidence& evidence) {
  constexpr int kReach = 3;
  OrientationSum edge;
  for (const EdgePixel& pixel : silhouette(scene, kReach)) {
    const auto at =
        static_cast<size_t>(pixel.y) * static_cast<size_t>(scene.width) + static_cast<size_t>(pixel.x);
    const Polarisation p = polarisation(scene, at);
    const double phi = std::atan2(pixel.out_y, pixel.out_x);
    edge.add(p, phi);
    evidence.edge_radial += p.s1 * std::cos(2 * phi) + p.s2 * std::sin(2 * phi);
    evidence.edge_length += p.dop();
  }
  evidence.edge = edge.result();
}

void add_normals(const Scene& scene, SignEvidence& evidence) {
  // Between facing the camera, where the normal has no direction in the image, and the silhouette.
  constexpr float kSteep = 0.05F;
  constexpr float kFlat = 0.9F;
  // Under this share of the image's light the pure-BSDF image leaves mostly light that scattered.
  constexpr double kScattered = 0.3;
  OrientationSum sum;
  for (size_t i = 0; i < scene.mask.size(); ++i) {
    const float nz = std::abs(scene.normal[3 * i + 2]);
    if (scene.mask[i] == 0 || !(nz > kSteep && nz < kFlat)) continue;
    const Polarisation p = polarisation(scene, i);
    const double phi =
        std::atan2(static_cast<double>(scene.normal[3 * i + 1]), static_cast<double>(scene.normal[3 * i]));
    sum.add(p, phi);
    if (scene.bsdf.empty()) continue;
    if (!(sum_of_colours(scene.bsdf, i, 0) < kScattered * sum_of_colours(scene.image, i, 0))) continue;
    evidence.radial_1 += p.s1 * std::cos(2 * phi);
    evidence.radial_2 += p.s2 * std::sin(2 * phi);
    evidence.radial_length += p.dop();
    evidence.radial_pixels += 1;
  }
  evidence.normal = sum.result();
}

/// A mean over its standard deviation.
double significance(double sum, double variance) {
  return variance > 0 ? sum / std::sqrt(variance) : 0;
}

}  // namespace

PairCheck check_pairs(const PolariserImages& images, const std::vector<uint8_t>& mask) {
  PairCheck check;
  int64_t object = 0;
  int64_t clipped = 0;
  for (size_t i = 0; i < images.clipped.size(); ++i) {
    if (mask[i / 3] == 0) continue;
    ++object;
    clipped += images.clipped[i];
  }
  if (object > 0) check.saturated = static_cast<double>(clipped) / static_cast<double>(object);
  const std::vector<size_t> at = well_exposed(images, mask);
  check.values = static_cast<int64_t>(at.size());
  if (at.empty()) return check;
  constexpr std::array<std::array<size_t, 4>, 3> kPairings = {{{0, 2, 1, 3}, {0, 1, 2, 3}, {0, 3, 1, 2}}};
  for (size_t k = 0; k < kPairings.size(); ++k) {
    const std::vector<double> off = mismatch(images, at, kPairings[k]);
    const double centre = median(off);
    check.spread[k] = median_deviation(off, centre);
    if (k > 0) continue;
    check.ratio = 1 + centre;
    double squares = 0;
    for (const double value : off) squares += value * value;
    check.rms = std::sqrt(squares / static_cast<double>(off.size()));
  }
  return check;
}

GammaEvidence& GammaEvidence::operator+=(const GammaEvidence& other) {
  for (size_t k = 0; k < kCount; ++k) {
    xx[k] += other.xx[k];
    xy[k] += other.xy[k];
    yy[k] += other.yy[k];
  }
  values += other.values;
  log_xx += other.log_xx;
  log_xy += other.log_xy;
  return *this;
}

GammaEvidence gamma_evidence(const StoredLight& light, const std::vector<uint8_t>& mask) {
  const PolariserImages& images = light.polarisers;
  const std::vector<size_t> at = well_exposed(images, mask);
  GammaEvidence evidence;
  if (!light.stokes[0].empty()) {
    Moments logs;
    for (const size_t i : at) {
      double sum = 0;
      for (const std::vector<float>& image : images.images) sum += static_cast<double>(image[i]);
      const auto stored = static_cast<double>(light.stokes[0][i]);
      if (stored > 0) logs.add(std::log(sum / 2), std::log(stored));
    }
    evidence.log_xx = logs.centred_xx();
    evidence.log_xy = logs.centred_xy();
  }
  std::vector<std::array<double, 4>> values(at.size());
  std::vector<std::array<double, 4>> step(at.size());
  for (size_t i = 0; i < at.size(); ++i) {
    for (size_t angle = 0; angle < 4; ++angle) {
      const auto value = static_cast<double>(images.images[angle][at[i]]);
      values[i][angle] = std::pow(value, kFirstGamma / kDeclaredGamma);
      step[i][angle] = std::pow(value, kGammaStep / kDeclaredGamma);
    }
  }
  evidence.values = static_cast<double>(at.size());
  for (size_t k = 0; k < GammaEvidence::kCount; ++k) {
    const Moments m = gamma_moments(values, step);
    evidence.xx[k] = m.centred_xx();
    evidence.xy[k] = m.centred_xy();
    evidence.yy[k] = m.centred_yy();
  }
  return evidence;
}

bool GammaMatch::agrees() const {
  constexpr double kTolerance = 0.25;  // sRGB's curve counts as 2.2
  constexpr double kStokesTolerance = 0.1;
  const bool images = !known || std::abs(gamma - kDeclaredGamma) <= std::max(kTolerance, 2.5 * error);
  return images && (!by_stokes || std::abs(*by_stokes - kDeclaredGamma) <= kStokesTolerance);
}

GammaMatch match_gamma(const GammaEvidence& e) {
  GammaMatch match;
  if (e.log_xx > 0) match.by_stokes = kDeclaredGamma * e.log_xy / e.log_xx;
  constexpr double kFewest = 300;
  if (e.values < kFewest || !(*std::min_element(e.xx.begin(), e.xx.end()) > 0)) return match;
  std::array<double, GammaEvidence::kCount> slope{};
  for (size_t k = 0; k < slope.size(); ++k) slope[k] = e.xy[k] / e.xx[k];
  // The slope rises with the exponent; it is zero at the right one. Outside of the grid the ends' line goes
  // on.
  size_t k = 0;
  while (k + 2 < slope.size() && slope[k + 1] < 0) ++k;
  const double rise = (slope[k + 1] - slope[k]) / (grid_gamma(k + 1) - grid_gamma(k));
  if (!(rise > 0)) return match;
  match.gamma = grid_gamma(k) - slope[k] / rise;
  // Colours and neighbours are not independent: the textbook's error is too small, by about three.
  constexpr double kDependence = 3;
  const double residual = std::max(0.0, e.yy[k] - slope[k] * e.xy[k]) / e.values;
  match.error = kDependence * std::sqrt(residual / e.xx[k]) / rise;
  match.known = match.error < 0.2 && match.gamma > 0.3 && match.gamma < 6;
  return match;
}

std::string to_string(const GammaMatch& match) {
  std::string text =
      match.known ? fmt::format("{:.2f} +- {:.2f} by the four images", match.gamma, match.error)
      : match.gamma > 0.0
          ? fmt::format("undecided by the four images ({:.1f} +- {:.1f})", match.gamma, match.error)
          : "undecided by the four images";
  if (match.by_stokes) text += fmt::format(", {:.2f} by s0.npy", *match.by_stokes);
  return text;
}

Orientation& Orientation::operator+=(const Orientation& other) {
  weight += other.weight;
  along += other.along;
  square += other.square;
  along_variance += other.along_variance;
  square_variance += other.square_variance;
  return *this;
}

SignEvidence& SignEvidence::operator+=(const SignEvidence& other) {
  edge += other.edge;
  normal += other.normal;
  radial_1 += other.radial_1;
  radial_2 += other.radial_2;
  radial_length += other.radial_length;
  radial_pixels += other.radial_pixels;
  edge_radial += other.edge_radial;
  edge_length += other.edge_length;
  return *this;
}

SignEvidence sign_evidence(const Scene& scene) {
  SignEvidence evidence;
  add_silhouette(scene, evidence);
  if (!scene.normal.empty()) add_normals(scene, evidence);
  return evidence;
}

SignMatch match_signs(const SignEvidence& e, const FrameMatch& frame) {
  constexpr double kSure = 2.5;  // standard deviations
  SignMatch match;
  Orientation o = e.edge;
  const bool mirrored_phi = frame.flip_x != frame.flip_y;
  if (frame.known && e.normal.weight > 0) {
    o = e.normal;
    if (mirrored_phi) o.along = -o.along;
  }
  if (e.edge_length > 0) match.edge_radial = e.edge_radial / e.edge_length;
  if (!(o.weight > 0)) return match;
  match.along = o.along / o.weight;
  match.square = o.square / o.weight;
  const double along = significance(o.along, o.along_variance);
  const double square = significance(o.square, o.square_variance);
  match.known = std::abs(along) > kSure && std::abs(square) > kSure;
  if (!match.known) return match;
  match.turned = square < 0;
  match.mirrored = !match.turned && along < 0;
  if (match.turned) return match;
  // The signs that make scattered light lie along the normal.
  constexpr double kPixels = 60;
  constexpr double kClear = 0.3;
  const double sign = match.mirrored != mirrored_phi ? -1 : 1;
  const double radial = e.radial_length > 0 ? (e.radial_1 + sign * e.radial_2) / e.radial_length : 0;
  match.radial = std::abs(radial);
  match.polarity = frame.known && e.radial_pixels >= kPixels && match.radial > kClear;
  if (!match.polarity) return match;
  match.flip_1 = radial < 0;
  match.flip_2 = match.mirrored != match.flip_1;
  return match;
}

std::string to_string(const SignMatch& match) {
  const std::string strength = fmt::format("(along {:.2f}, square {:.2f})", match.along, match.square);
  if (!match.known) return "undecided " + strength;
  if (match.turned) return "the polarisers' angles are off by 45 degrees " + strength;
  if (match.polarity) {
    const std::string scattered = fmt::format("(scattered light {:.2f} along the normal)", match.radial);
    if (match.flip_1 && match.flip_2) return "s1 and s2 both have the wrong sign " + scattered;
    if (match.flip_1 || match.flip_2) {
      return fmt::format("{} has the wrong sign {}", match.flip_1 ? "s1" : "s2", scattered);
    }
    return "s1 and s2 right " + scattered;
  }
  if (match.mirrored) return "s1 or s2 has the wrong sign " + strength;
  return fmt::format("s1 and s2 fit each other {}; light at silhouettes is mostly polarised {} the normal",
                     strength, match.edge_radial > 0 ? "along" : "across");
}

}  // namespace opaline
