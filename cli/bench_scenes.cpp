#include "cli/bench_scenes.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string>
#include <utility>
#include <vector>

#include "core/random.h"
#include "data/render/geometry.h"
#include "data/render/room.h"

namespace opaline::cli {
namespace {

using render::Environment;
using render::Illumination;
using render::mean;
using render::Rgb;
using render::Vec3;

constexpr double kPi = std::numbers::pi;

void add_uniform(Illumination& light) {
  light.environment = Environment(Rgb{1.0, 1.0, 1.0});
}

void add_flash(Illumination& light) {
  light.flash.radiance = 50.0;
}

/// A drawn room that sends a fifth of what the flash does, as data sets have it.
void add_flash_and_room(Illumination& light) {
  add_flash(light);
  Random random(1, Purpose::kTest, 0, 0);
  light.environment = render::make_room(random);
  const double wanted = 0.2 * light.flash.irradiance({});
  light.environment.scale(wanted / (mean(light.environment.fluence()) / 4.0));
}

/// Walls of radiance 1 to 2 and four lamps of 1e5, each about 3 degrees wide; scaled to the fluence of
/// uniform light of radiance 1.
void add_contrast(Illumination& light) {
  constexpr int64_t kHeight = 128, kWidth = 256;
  constexpr std::array<std::array<int64_t, 2>, 4> kLamps = {{{16, 20}, {30, 96}, {44, 150}, {70, 230}}};
  std::vector<Rgb> texels(static_cast<size_t>(kHeight * kWidth));
  for (int64_t row = 0; row < kHeight; ++row) {
    for (int64_t column = 0; column < kWidth; ++column) {
      const double longitude = 2.0 * kPi * static_cast<double>(column) / static_cast<double>(kWidth);
      const double wall = 1.5 + 0.5 * std::cos(2.0 * longitude);
      texels[static_cast<size_t>(row * kWidth + column)] = {wall, wall, wall};
    }
  }
  for (const auto& [row, column] : kLamps) {
    for (int64_t i = 0; i < 2; ++i)
      for (int64_t j = 0; j < 2; ++j)
        texels[static_cast<size_t>((row + i) * kWidth + column + j)] = {1e5, 1e5, 1e5};
  }
  light.environment = Environment(std::move(texels), kWidth);
  light.environment.scale(4.0 * kPi / mean(light.environment.fluence()));
}

constexpr render::Medium kGrey{.sigma_t = {16.0, 16.0, 16.0}, .albedo = {0.8, 0.8, 0.8}, .g = 0.5};
constexpr render::Medium kColoured{.sigma_t = {10.0, 16.0, 24.0}, .albedo = {0.9, 0.8, 0.6}, .g = 0.6};
constexpr render::Medium kDense{.sigma_t = {32.0, 32.0, 32.0}, .albedo = {0.95, 0.9, 0.85}, .g = 0.9};

}  // namespace

const std::array<BenchScene, 7>& bench_scenes() {
  static constexpr std::array<BenchScene, 7> kScenes = {{
      {"uniform", "grey medium, uniform light", kGrey, add_uniform, true},
      {"flash", "grey medium, the flash alone", kGrey, add_flash, true},
      {"room", "coloured medium, flash and room", kColoured, add_flash_and_room},
      {"dense", "dense medium, flash and room", kDense, add_flash_and_room},
      {"clear", "no medium, flash and room", {}, add_flash_and_room},
      {kContrast, "coloured medium, room of contrast 1e5", kColoured, add_contrast},
      {kContrastUniform, "the same in uniform light of equal fluence", kColoured, add_uniform},
  }};
  return kScenes;
}

render::Mesh bench_body(const render::Camera& camera) {
  constexpr double kRadius = 0.155;
  const double facet = 0.5 * camera.pixel_size(kRadius);
  const int sides = std::clamp(static_cast<int>(std::ceil(0.5 * kPi * kRadius / facet)), 16, 1024);
  render::Mesh mesh = render::cube_sphere(sides);
  for (auto& v : mesh.vertices) {
    const double x = v[0], y = v[1], z = v[2];
    const double dents =
        0.16 * std::sin(4.0 * x + 1.0) * std::sin(3.0 * y - 0.5) + 0.08 * std::cos(5.0 * z - 2.0 * x);
    const double ripples = 0.012 * std::sin(21.0 * x + 2.0) * std::sin(19.0 * y) * std::sin(23.0 * z + 1.0);
    const auto radius = static_cast<float>(kRadius * (1.0 + dents + ripples));
    for (float& c : v) c *= radius;
  }
  return mesh;
}

render::SceneModel make_bench_scene(const BenchScene& scene, const render::Camera& camera) {
  const render::Mesh mesh = bench_body(camera);
  render::SceneModel model;
  model.object = "bench body";
  model.environment = std::string(scene.name);
  model.medium = scene.medium;
  scene.light(model.light);
  model.low = {render::kInfinity, render::kInfinity, render::kInfinity};
  model.high = -model.low;
  for (const auto& v : mesh.vertices) {
    const Vec3 p{v[0], v[1], v[2]};
    model.low = {std::min(model.low.x, p.x), std::min(model.low.y, p.y), std::min(model.low.z, p.z)};
    model.high = {std::max(model.high.x, p.x), std::max(model.high.y, p.y), std::max(model.high.z, p.z)};
  }
  model.geometry = render::make_mesh_geometry(mesh);
  return model;
}

}  // namespace opaline::cli
