#include "data/check_light.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>

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

}  // namespace opaline
