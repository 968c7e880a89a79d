#include "data/render/noise.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstddef>

namespace opaline::render {
namespace {

uint32_t mix(uint32_t h) {
  // The finaliser of MurmurHash3 (Appleby 2011): every input bit reaches every output bit.
  h ^= h >> 16;
  h *= 0x85EBCA6BU;
  h ^= h >> 13;
  h *= 0xC2B2AE35U;
  return h ^ (h >> 16);
}

// The gradient at a lattice point, one of the twelve edge directions, times the way to p.
double corner(int32_t x, int32_t y, int32_t z, uint32_t key, const Vec3& way) {
  const uint32_t h = mix(static_cast<uint32_t>(x) * 0x9E3779B1U ^
                         mix(static_cast<uint32_t>(y) * 0x85EBCA77U ^ mix(static_cast<uint32_t>(z) ^ key)));
  const double a = (h & 1U) != 0 ? 1.0 : -1.0, b = (h & 2U) != 0 ? 1.0 : -1.0;
  switch ((h >> 2) % 3) {
    case 0:
      return a * way.x + b * way.y;
    case 1:
      return a * way.x + b * way.z;
    default:
      return a * way.y + b * way.z;
  }
}

double blend(double t) {
  return t * t * t * (t * (t * 6.0 - 15.0) + 10.0);
}

}  // namespace

double gradient_noise(const Vec3& p, uint32_t key) {
  const double fx = std::floor(p.x), fy = std::floor(p.y), fz = std::floor(p.z);
  const auto x = static_cast<int32_t>(fx), y = static_cast<int32_t>(fy), z = static_cast<int32_t>(fz);
  const Vec3 f{p.x - fx, p.y - fy, p.z - fz};
  std::array<double, 8> value{};
  for (size_t i = 0; i < 8; ++i) {
    const int32_t dx = i & 1U ? 1 : 0, dy = i & 2U ? 1 : 0, dz = i & 4U ? 1 : 0;
    value[i] = corner(x + dx, y + dy, z + dz, key, f - Vec3{double(dx), double(dy), double(dz)});
  }
  const double u = blend(f.x), v = blend(f.y), w = blend(f.z);
  const auto lerp = [](double t, double a, double b) { return a + t * (b - a); };
  return lerp(w, lerp(v, lerp(u, value[0], value[1]), lerp(u, value[2], value[3])),
              lerp(v, lerp(u, value[4], value[5]), lerp(u, value[6], value[7])));
}

double fractal_noise(const Vec3& p, uint32_t key, int octaves) {
  double sum = 0.0, height = 1.0, frequency = 1.0;
  for (int i = 0; i < octaves; ++i) {
    sum += height * gradient_noise(p * frequency, key + static_cast<uint32_t>(i));
    height *= 0.5;
    frequency *= 2.0;
  }
  return sum;
}

double cell_noise(const Vec3& p, uint32_t key) {
  const double fx = std::floor(p.x), fy = std::floor(p.y), fz = std::floor(p.z);
  const auto x = static_cast<int32_t>(fx), y = static_cast<int32_t>(fy), z = static_cast<int32_t>(fz);
  double nearest2 = 1e30;
  for (int32_t k = -1; k <= 1; ++k) {
    for (int32_t j = -1; j <= 1; ++j) {
      for (int32_t i = -1; i <= 1; ++i) {
        const uint32_t h =
            mix(static_cast<uint32_t>(x + i) * 0x9E3779B1U ^
                mix(static_cast<uint32_t>(y + j) * 0x85EBCA77U ^ mix(static_cast<uint32_t>(z + k) ^ key)));
        const auto part = [h](unsigned shift) { return (h >> shift & 0x3FFU) / 1024.0; };
        const Vec3 way{fx + i + part(0) - p.x, fy + j + part(10) - p.y, fz + k + part(20) - p.z};
        nearest2 = std::min(nearest2, dot(way, way));
      }
    }
  }
  // Points beyond the neighbouring cells are at least 1 away.
  return std::sqrt(std::min(nearest2, 1.0));
}

}  // namespace opaline::render
