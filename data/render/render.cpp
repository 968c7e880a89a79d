#include "data/render/render.h"

#include <algorithm>
#include <cmath>

#include "core/parallel.h"

namespace opaline::render {
namespace {

/// What a pixel sums over its samples.
struct PixelSum {
  StokesRgb image{}, bsdf{};
  Vec3 normal{};
  double depth = 0.0;
  int64_t hits = 0;

  void add(const PathSample& sample, BsdfReading reading) {
    if (!sample.hit) {
      for (size_t c = 0; c < 3; ++c) {
        image[0][c] += sample.background[c];
        bsdf[0][c] += sample.background[c];
      }
      return;
    }
    const StokesRgb& pure = reading == BsdfReading::kClear ? sample.clear : sample.mirror;
    for (size_t i = 0; i < 3; ++i) {
      for (size_t c = 0; c < 3; ++c) {
        image[i][c] += sample.reflected[i][c] + sample.unscattered[i][c] + sample.scattered[i][c];
        bsdf[i][c] += pure[i][c];
      }
    }
    normal = normal + sample.normal;
    depth += sample.position.z / kCube;
    ++hits;
  }
};

}  // namespace

SceneRender render_scene(const SceneModel& scene, const Camera& camera, const RenderOptions& options) {
  const int width = camera.width, height = camera.height;
  const auto strata =
      static_cast<int64_t>(std::ceil(std::sqrt(static_cast<double>(std::max<int64_t>(options.spp, 1)))));
  World world = scene.world();
  Guide guide;
  if (!world.medium.empty()) {
    guide = Guide(world, scene.light, scene.low, scene.high,
                  Random(options.seed, Purpose::kRender, UINT32_MAX, options.number), options.guide);
    world.guide = &guide;
  }

  const auto pixels = static_cast<size_t>(width) * static_cast<size_t>(height);
  SceneRender result;
  result.width = width;
  result.height = height;
  result.image.resize(9 * pixels);
  result.bsdf.resize(9 * pixels);
  result.normal.resize(3 * pixels);
  result.depth.resize(pixels);
  result.coverage.resize(pixels);
  std::vector<PathFaults> faults(static_cast<size_t>(height));
  parallel_for(height, [&](int64_t row) {
    for (int64_t column = 0; column < width; ++column) {
      const auto pixel = static_cast<size_t>(row * width + column);
      Random random(options.seed, Purpose::kRender, static_cast<uint32_t>(pixel), options.number);
      PixelSum sum;
      for (int64_t s = 0; s < strata * strata; ++s) {
        const double x = static_cast<double>(column) +
                         (static_cast<double>(s % strata) + random.uniform()) / static_cast<double>(strata);
        const double y = static_cast<double>(row) +
                         (static_cast<double>(s / strata) + random.uniform()) / static_cast<double>(strata);
        sum.add(sample_path(world, camera.ray(x, y), random, faults[static_cast<size_t>(row)]), options.bsdf);
      }
      const double scale = 1.0 / static_cast<double>(strata * strata);
      for (size_t i = 0; i < 3; ++i) {
        for (size_t c = 0; c < 3; ++c) {
          result.image[9 * pixel + 3 * i + c] = static_cast<float>(sum.image[i][c] * scale);
          result.bsdf[9 * pixel + 3 * i + c] = static_cast<float>(sum.bsdf[i][c] * scale);
        }
      }
      result.coverage[pixel] = static_cast<float>(static_cast<double>(sum.hits) * scale);
      if (sum.hits == 0) continue;
      result.depth[pixel] = static_cast<float>(sum.depth / static_cast<double>(sum.hits));
      const double length = norm(sum.normal);
      const Vec3 n = length > 0.0 ? sum.normal * (1.0 / length) : Vec3{0.0, 0.0, 1.0};
      result.normal[3 * pixel] = static_cast<float>(n.x);
      result.normal[3 * pixel + 1] = static_cast<float>(n.y);
      result.normal[3 * pixel + 2] = static_cast<float>(n.z);
    }
  });
  for (const PathFaults& row : faults) {
    result.faults.lost += row.lost;
    result.faults.paths += row.paths;
  }
  return result;
}

bool well_framed(const std::vector<float>& coverage, int width, int height) {
  bool whole = false;
  for (int i = 0; i < height; ++i) {
    for (int j = 0; j < width; ++j) {
      const float a = coverage[static_cast<size_t>(i) * static_cast<size_t>(width) + static_cast<size_t>(j)];
      const bool border = i == 0 || j == 0 || i == height - 1 || j == width - 1;
      if (border && a > 0.0F) return false;
      whole = whole || a >= 1.0F;
    }
  }
  return whole;
}

}  // namespace opaline::render
