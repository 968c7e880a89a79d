// A vector of three doubles. World axes: x right, y up, z towards the camera; metres.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>

namespace opaline::render {

struct Vec3 {
  double x = 0;
  double y = 0;
  double z = 0;
};

/// Red, green, blue.
using Rgb = std::array<double, 3>;

constexpr Rgb product(const Rgb& a, const Rgb& b) {
  return {a[0] * b[0], a[1] * b[1], a[2] * b[2]};
}
constexpr Rgb scaled(const Rgb& a, double s) {
  return {a[0] * s, a[1] * s, a[2] * s};
}
constexpr double mean(const Rgb& c) {
  return (c[0] + c[1] + c[2]) / 3.0;
}
constexpr double largest(const Rgb& c) {
  return std::max({c[0], c[1], c[2]});
}

constexpr Vec3 operator+(const Vec3& a, const Vec3& b) {
  return {a.x + b.x, a.y + b.y, a.z + b.z};
}
constexpr Vec3 operator-(const Vec3& a, const Vec3& b) {
  return {a.x - b.x, a.y - b.y, a.z - b.z};
}
constexpr Vec3 operator-(const Vec3& a) {
  return {-a.x, -a.y, -a.z};
}
constexpr Vec3 operator*(const Vec3& a, double s) {
  return {a.x * s, a.y * s, a.z * s};
}
constexpr Vec3 operator*(double s, const Vec3& a) {
  return a * s;
}
constexpr double dot(const Vec3& a, const Vec3& b) {
  return a.x * b.x + a.y * b.y + a.z * b.z;
}
constexpr Vec3 cross(const Vec3& a, const Vec3& b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
inline double norm(const Vec3& a) {
  return std::sqrt(dot(a, a));
}
inline Vec3 normalised(const Vec3& a) {
  return a * (1.0 / norm(a));
}

/// Two unit vectors that make a right-handed frame (first, second, w) with the unit vector w (Duff et al.,
/// "Building an orthonormal basis, revisited", JCGT 2017).
struct Basis {
  Vec3 first;
  Vec3 second;
};
inline Basis basis_around(const Vec3& w) {
  const double sign = std::copysign(1.0, w.z);
  const double a = -1.0 / (sign + w.z);
  const double b = w.x * w.y * a;
  return {{1.0 + sign * w.x * w.x * a, sign * b, -sign * w.x}, {b, sign + w.y * w.y * a, -w.y}};
}

/// The unit vector at angle acos(cosine) from the unit vector w, turned by `azimuth` around it.
inline Vec3 around(const Vec3& w, double cosine, double azimuth) {
  const Basis basis = basis_around(w);
  const double sine = std::sqrt(std::fmax(0.0, 1.0 - cosine * cosine));
  return basis.first * (sine * std::cos(azimuth)) + basis.second * (sine * std::sin(azimuth)) + w * cosine;
}

}  // namespace opaline::render
