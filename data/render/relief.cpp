#include "data/render/relief.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "data/render/noise.h"

namespace opaline::render {
namespace {

constexpr double kPi = std::numbers::pi;
/// Bumps are at most this share of the thinnest wall, and of the radius of curvature.
constexpr double kMostOfWall = 0.2, kMostOfRadius = 0.4;

/// Reads the map bilinearly at a point of the plane, in texels, mirrored at the borders.
double read_mirrored(const HeightMap& map, double x, double y) {
  const auto fold = [](double v, int n) {
    const double period = 2.0 * n;
    const double inside = v - std::floor(v / period) * period;
    return std::clamp(inside < n ? inside : period - inside, 0.0, static_cast<double>(n)) - 0.5;
  };
  const double u = std::clamp(fold(x, map.width), 0.0, static_cast<double>(map.width - 1));
  const double v = std::clamp(fold(y, map.height), 0.0, static_cast<double>(map.height - 1));
  const int x0 = static_cast<int>(u), y0 = static_cast<int>(v);
  const int x1 = std::min(x0 + 1, map.width - 1), y1 = std::min(y0 + 1, map.height - 1);
  const double fx = u - x0, fy = v - y0;
  const auto at = [&map](int i, int j) {
    return static_cast<double>(
        map.values[static_cast<size_t>(j) * static_cast<size_t>(map.width) + static_cast<size_t>(i)]);
  };
  return (1.0 - fy) * ((1.0 - fx) * at(x0, y0) + fx * at(x1, y0)) +
         fy * ((1.0 - fx) * at(x0, y1) + fx * at(x1, y1));
}

struct MapRange {
  double middle, steepest;
};

MapRange measure(const HeightMap& map) {
  double sum = 0.0, steepest = 0.0;
  for (int j = 0; j < map.height; ++j) {
    for (int i = 0; i < map.width; ++i) {
      const size_t at = static_cast<size_t>(j) * static_cast<size_t>(map.width) + static_cast<size_t>(i);
      const double value = map.values[at];
      sum += value;
      const double right = i + 1 < map.width ? map.values[at + 1] - value : 0.0;
      const double down = j + 1 < map.height ? map.values[at + static_cast<size_t>(map.width)] - value : 0.0;
      steepest = std::max(steepest, std::hypot(right, down));
    }
  }
  return {sum / static_cast<double>(map.values.size()), steepest};
}

/// How far each point may move at most: `largest`, less where that would fold the surface over, which is
/// where it exceeds the radius of curvature. Between points the bound changes by `slope` x distance at most.
std::vector<double> room_for_bumps(const Surface& surface, const std::vector<Vec3>& normals, double largest,
                                   double slope) {
  std::vector<double> room(surface.points.size(), largest);
  bool tight = false;
  for (const auto& t : surface.triangles) {
    for (size_t e = 0; e < 3; ++e) {
      const uint32_t a = t[e], b = t[(e + 1) % 3];
      const Vec3 edge = surface.points[b] - surface.points[a];
      const double bend = std::abs(dot(normals[b] - normals[a], edge));
      const double most = kMostOfRadius * dot(edge, edge) / std::max(bend, 1e-12);
      if (!(most < largest)) continue;
      room[a] = std::min(room[a], most);
      room[b] = std::min(room[b], most);
      tight = true;
    }
  }
  constexpr int kSweeps = 6;  // enough facets around a crease; far ones keep a step that is under `largest`
  for (int sweep = 0; tight && sweep < kSweeps; ++sweep) {
    for (const auto& t : surface.triangles) {
      for (size_t e = 0; e < 3; ++e) {
        const uint32_t a = t[e], b = t[(e + 1) % 3];
        if (room[a] == largest && room[b] == largest) continue;
        const double step = slope * norm(surface.points[b] - surface.points[a]);
        room[b] = std::min(room[b], room[a] + step);
        room[a] = std::min(room[a], room[b] + step);
      }
    }
  }
  return room;
}

}  // namespace

Relief draw_noise_relief(Random& random) {
  const uint32_t key = random.bits(), kind = random.below(4);
  const double frequency = 3.0 * std::pow(4.0, random.uniform());
  const Vec3 axis = around({0.0, 0.0, 1.0}, random.uniform(-1.0, 1.0), random.uniform(0.0, 2.0 * kPi));
  const double warp = random.uniform(0.0, 1.5);
  // Noise has gradients up to 2.8 x frequency, rarely; its second octave as much again, elsewhere.
  switch (kind) {
    case 0:
      return {[=](const Vec3& p, const Vec3&) {
                return (0.5 - std::abs(gradient_noise(p * frequency, key))) / (2.8 * frequency);
              },
              0.2 / frequency};
    case 1: {
      const double grain = 0.5 * frequency;
      return {[=](const Vec3& p, const Vec3&) { return (cell_noise(p * grain, key) - 0.5) / grain; },
              0.5 / grain};
    }
    case 2: {
      const double waves = 2.0 * frequency / (1.0 + 1.4 * warp);
      return {[=](const Vec3& p, const Vec3&) {
                const double bent = dot(p, axis) + warp / 3.0 * gradient_noise(p * 1.5, key);
                return std::sin(waves * bent) / (2.0 * frequency);
              },
              0.5 / frequency};
    }
    default:
      return {[=](const Vec3& p, const Vec3&) {
                return fractal_noise(p * frequency, key, 2) / (3.5 * frequency);
              },
              0.3 / frequency};
  }
}

Relief draw_map_relief(const HeightMap& map, Random& random) {
  const MapRange range = measure(map);
  const double across = 1.0 * std::pow(3.0, random.uniform());  // radii along the map's width
  const double turn = random.uniform(0.0, 2.0 * kPi);
  const Vec3 shift{random.uniform(0.0, 10.0), random.uniform(0.0, 10.0), random.uniform(0.0, 10.0)};
  if (!(range.steepest > 0.0)) return {[](const Vec3&, const Vec3&) { return 0.0; }, 0.0};
  const double texels = map.width / across, scale = 1.0 / (range.steepest * texels);
  const double c = std::cos(turn) * texels, s = std::sin(turn) * texels;
  double amplitude = 0.0;
  for (const float value : map.values)
    amplitude = std::max(amplitude, std::abs(value - range.middle) * scale);
  return {[=, &map](const Vec3& p, const Vec3& n) {
            const auto side = [&](double u, double v) {
              return read_mirrored(map, c * u - s * v, s * u + c * v);
            };
            const double x = std::pow(n.x, 4), y = std::pow(n.y, 4), z = std::pow(n.z, 4);
            const Vec3 q = p + shift;
            const double sum = x * side(q.y, q.z) + y * side(q.z, q.x) + z * side(q.x, q.y);
            return (sum / (x + y + z) - range.middle) * scale;
          },
          amplitude};
}

void displace(Surface& surface, const Relief& relief, double slope) {
  if (!(slope * relief.amplitude > 0.0)) return;
  const double scale = std::min(slope, kMostOfWall * surface.thickness / relief.amplitude);
  const std::vector<Vec3> normals = vertex_normals(surface);
  const std::vector<double> room = room_for_bumps(surface, normals, scale * relief.amplitude, slope);
  for (size_t i = 0; i < surface.points.size(); ++i) {
    Vec3& p = surface.points[i];
    p = p + normals[i] * std::clamp(scale * relief.height(p, normals[i]), -room[i], room[i]);
  }
}

}  // namespace opaline::render
