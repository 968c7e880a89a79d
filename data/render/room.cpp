#include "data/render/room.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <vector>

#include "data/render/noise.h"

namespace opaline::render {
namespace {

constexpr double kPi = std::numbers::pi;

/// A rectangle on a side of the unit cube that the room is mapped to.
struct Window {
  size_t side;  // 2 axis + (1 where positive)
  double u0, u1, v0, v1;
  Rgb radiance;
};

/// Seen as a disc.
struct Lamp {
  Vec3 direction;
  double cosine;  // of its angular radius
  Rgb radiance;
};

/// Where a direction meets the room's sides.
struct WallPoint {
  size_t side;
  double u, v;  // -1 to 1
};

struct Room {
  Vec3 half;  // width, height, depth
  std::array<Rgb, 6> walls;
  std::vector<Window> windows;
  std::vector<Lamp> lamps;
  uint32_t key;
  double texture;

  WallPoint meet(const Vec3& d) const {
    const std::array<double, 3> c{d.x / half.x, d.y / half.y, d.z / half.z};
    size_t axis = 0;
    for (size_t a = 1; a < 3; ++a)
      if (std::abs(c[a]) > std::abs(c[axis])) axis = a;
    const double scale = 1.0 / std::abs(c[axis]);
    return {2 * axis + (c[axis] > 0.0 ? 1 : 0), c[(axis + 1) % 3] * scale, c[(axis + 2) % 3] * scale};
  }

  Rgb wall(const Vec3& d) const {
    const auto [side, u, v] = meet(d);
    // Corners are darker, and nothing is plain.
    const double shade = (1.0 - 0.35 * u * u) * (1.0 - 0.35 * v * v);
    const Vec3 p{u * 3.0 + 0.5, v * 3.0 + 0.5, static_cast<double>(side) * 10.0 + 0.5};
    const double pattern = std::exp(texture * fractal_noise(p, key, 3));
    Rgb result = walls[side];
    for (double& value : result) value *= shade * pattern;
    return result;
  }

  /// What shines in front of the wall, or null.
  const Rgb* light(const Vec3& d) const {
    for (const Lamp& lamp : lamps)
      if (dot(d, lamp.direction) >= lamp.cosine) return &lamp.radiance;
    const auto [side, u, v] = meet(d);
    for (const Window& window : windows) {
      if (window.side == side && u >= window.u0 && u < window.u1 && v >= window.v0 && v < window.v1) {
        return &window.radiance;
      }
    }
    return nullptr;
  }
};

Rgb tint(double brightness, double saturation, Random& random) {
  Rgb c{};
  for (double& value : c) value = brightness * std::exp(saturation * random.normal());
  return c;
}

Window draw_window(size_t side, const Rgb& radiance, Random& random) {
  const double width = random.uniform(0.1, 0.45), height = random.uniform(0.1, 0.45);
  const double u = random.uniform(-1.0 + width, 1.0 - width), v = random.uniform(-1.0 + height, 1.0 - height);
  return {side, u - width, u + width, v - height, v + height, radiance};
}

/// From the ceiling's middle down to a little under the horizon.
Lamp draw_lamp(const RoomOptions& options, Random& random) {
  const double up = random.uniform(-0.2, 1.0), azimuth = random.uniform(0.0, 2.0 * kPi);
  const double s = std::sqrt(1.0 - up * up);
  const double radius = draw_uniform(options.lamp, random) * kPi / 180.0;
  // The colour has unit mean: the contrast is that of the brightness.
  Rgb radiance = tint(1.0, 0.1, random);
  const double scale =
      3.0 * draw_log_uniform(options.contrast, random) / (radiance[0] + radiance[1] + radiance[2]);
  for (double& value : radiance) value *= scale;
  return {{s * std::cos(azimuth), up, s * std::sin(azimuth)}, std::cos(radius), radiance};
}

Room draw_room(const RoomOptions& options, Random& random) {
  constexpr size_t kFloor = 2, kCeiling = 3;
  Room room{.half = {random.uniform(1.5, 4.0), random.uniform(1.2, 2.0), random.uniform(1.5, 4.0)},
            .walls = {},
            .windows = {},
            .lamps = {},
            .key = random.bits(),
            .texture = random.uniform(0.1, 0.6)};
  for (size_t side = 0; side < 6; ++side) room.walls[side] = tint(random.uniform(0.3, 1.2), 0.25, random);
  for (double& value : room.walls[kFloor]) value *= 0.4;
  for (double& value : room.walls[kCeiling]) value *= 1.3;

  constexpr std::array<size_t, 4> kUpright = {0, 1, 4, 5};
  const uint32_t windows = random.below(4);
  for (uint32_t i = 0; i < windows; ++i) {
    const Rgb light = tint(draw_log_uniform({5.0, 100.0}, random), 0.15, random);
    room.windows.push_back(draw_window(kUpright[random.below(4)], light, random));
  }
  const uint32_t lamps = 1 + random.below(3);
  for (uint32_t i = 0; i < lamps; ++i) room.lamps.push_back(draw_lamp(options, random));
  return room;
}

}  // namespace

int64_t RoomOptions::height() const {
  const auto rows = static_cast<int64_t>(std::ceil(360.0 / std::max(lamp.low, 0.5)));
  return std::max<int64_t>(64, (rows + 15) / 16 * 16);
}

Environment make_room(Random& random, const RoomOptions& options) {
  const Room room = draw_room(options, random);
  const int64_t height = options.height(), width = 2 * height;
  const double turn = random.uniform(0.0, 2.0 * kPi);
  const auto direction = [&](double row, double column) {
    const double latitude = kPi * row / static_cast<double>(height);
    const double longitude = 2.0 * kPi * column / static_cast<double>(width) + turn;
    const double s = std::sin(latitude);
    return Vec3{s * std::sin(longitude), std::cos(latitude), -s * std::cos(longitude)};
  };

  std::vector<Rgb> texels(static_cast<size_t>(height * width));
  double sum = 0.0, weights = 0.0;
  for (int64_t i = 0; i < height; ++i) {
    const double row = static_cast<double>(i) + 0.5;
    const double weight = std::sin(kPi * row / static_cast<double>(height));
    for (int64_t j = 0; j < width; ++j) {
      const Rgb wall = room.wall(direction(row, static_cast<double>(j) + 0.5));
      texels[static_cast<size_t>(i * width + j)] = wall;
      sum += weight * (wall[0] + wall[1] + wall[2]) / 3.0;
      weights += weight;
    }
  }
  const double scale = weights / sum;
  // Windows and lamps have sharp edges: each texel is the mean of 2 x 2 points.
  constexpr int kParts = 2;
  constexpr double kShare = 1.0 / (kParts * kParts);
  for (int64_t i = 0; i < height; ++i) {
    for (int64_t j = 0; j < width; ++j) {
      Rgb& texel = texels[static_cast<size_t>(i * width + j)];
      Rgb light{};
      int lit = 0;
      for (int part = 0; part < kParts * kParts; ++part) {
        const Rgb* found = room.light(direction(static_cast<double>(i) + (part / kParts + 0.5) / kParts,
                                                static_cast<double>(j) + (part % kParts + 0.5) / kParts));
        if (found == nullptr) continue;
        ++lit;
        for (size_t c = 0; c < 3; ++c) light[c] += kShare * (*found)[c];
      }
      for (size_t c = 0; c < 3; ++c) texel[c] = light[c] + (1.0 - lit * kShare) * scale * texel[c];
    }
  }
  return {std::move(texels), width};
}

}  // namespace opaline::render
