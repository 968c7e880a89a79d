// The signs of s1 and s2, by how polarisation lies to normals and silhouettes.
#include <fmt/format.h>

#include <cmath>
#include <numbers>

#include "data/check_light.h"

namespace opaline {
namespace {

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
