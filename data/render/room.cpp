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
struct Panel {
  size_t side;  // 2 axis + (1 where positive)
  double u0, u1, v0, v1;
  Rgb radiance;
};

struct Room {
  Vec3 half;  // width, height, depth
  std::array<Rgb, 6> walls;
  std::vector<Panel> panels;
  uint32_t key;
  double texture;

  Rgb radiance(const Vec3& d) const {
    const std::array<double, 3> c{d.x / half.x, d.y / half.y, d.z / half.z};
    size_t axis = 0;
    for (size_t a = 1; a < 3; ++a)
      if (std::abs(c[a]) > std::abs(c[axis])) axis = a;
    const size_t side = 2 * axis + (c[axis] > 0.0 ? 1 : 0);
    const double scale = 1.0 / std::abs(c[axis]);
    const double u = c[(axis + 1) % 3] * scale, v = c[(axis + 2) % 3] * scale;
    for (const Panel& panel : panels) {
      if (panel.side == side && u >= panel.u0 && u < panel.u1 && v >= panel.v0 && v < panel.v1) {
        return panel.radiance;
      }
    }
    // Corners are darker, and nothing is plain.
    const double shade = (1.0 - 0.35 * u * u) * (1.0 - 0.35 * v * v);
    const Vec3 p{u * 3.0 + 0.5, v * 3.0 + 0.5, static_cast<double>(side) * 10.0 + 0.5};
    const double pattern = std::exp(texture * fractal_noise(p, key, 3));
    Rgb result = walls[side];
    for (double& value : result) value *= shade * pattern;
    return result;
  }
};

Rgb tint(double brightness, double saturation, Random& random) {
  Rgb c{};
  for (double& value : c) value = brightness * std::exp(saturation * random.normal());
  return c;
}

Panel draw_panel(size_t side, double size_low, double size_high, const Rgb& radiance, Random& random) {
  const double width = random.uniform(size_low, size_high), height = random.uniform(size_low, size_high);
  const double u = random.uniform(-1.0 + width, 1.0 - width), v = random.uniform(-1.0 + height, 1.0 - height);
  return {side, u - width, u + width, v - height, v + height, radiance};
}

double log_uniform(double low, double high, Random& random) {
  return low * std::pow(high / low, random.uniform());
}

}  // namespace

Environment make_room(Random& random, int64_t height) {
  constexpr size_t kFloor = 2, kCeiling = 3;
  Room room{.half = {random.uniform(1.5, 4.0), random.uniform(1.2, 2.0), random.uniform(1.5, 4.0)},
            .walls = {},
            .panels = {},
            .key = random.bits(),
            .texture = random.uniform(0.1, 0.6)};
  for (size_t side = 0; side < 6; ++side) room.walls[side] = tint(random.uniform(0.3, 1.2), 0.25, random);
  for (double& value : room.walls[kFloor]) value *= 0.4;
  for (double& value : room.walls[kCeiling]) value *= 1.3;

  constexpr std::array<size_t, 4> kUpright = {0, 1, 4, 5};
  const uint32_t windows = random.below(4);
  for (uint32_t i = 0; i < windows; ++i) {
    const Rgb light = tint(log_uniform(5.0, 100.0, random), 0.15, random);
    room.panels.push_back(draw_panel(kUpright[random.below(4)], 0.1, 0.45, light, random));
  }
  const uint32_t lamps = random.below(4);
  for (uint32_t i = 0; i < lamps; ++i) {
    const Rgb light = tint(log_uniform(50.0, 1000.0, random), 0.1, random);
    room.panels.push_back(draw_panel(kCeiling, 0.03, 0.12, light, random));
  }

  const int64_t width = 2 * height;
  const double turn = random.uniform(0.0, 2.0 * kPi);
  std::vector<Rgb> texels(static_cast<size_t>(height * width));
  for (int64_t i = 0; i < height; ++i) {
    for (int64_t j = 0; j < width; ++j) {
      Rgb& texel = texels[static_cast<size_t>(i * width + j)];
      for (int part = 0; part < 4; ++part) {
        const double row = static_cast<double>(i) + 0.25 + 0.5 * (part / 2);
        const double column = static_cast<double>(j) + 0.25 + 0.5 * (part % 2);
        const double latitude = kPi * row / static_cast<double>(height);
        const double longitude = 2.0 * kPi * column / static_cast<double>(width) + turn;
        const double s = std::sin(latitude);
        const Rgb light =
            room.radiance({s * std::sin(longitude), std::cos(latitude), -s * std::cos(longitude)});
        for (size_t c = 0; c < 3; ++c) texel[c] += 0.25 * light[c];
      }
    }
  }
  return {std::move(texels), width};
}

}  // namespace opaline::render
