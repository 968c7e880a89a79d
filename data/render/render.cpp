#include "data/render/render.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "core/parallel.h"
#include "data/render/plan.h"

namespace opaline::render {
namespace {

/// Streams of one pixel, besides its number: pilot and final samples must not share numbers.
enum class Pass : uint32_t { kFinal = 0, kPilot = 1, kBsdf = 2 };
constexpr uint32_t kPasses = 4;
/// Light no denser than this (data/render/guide.h) needs no guide: refraction and extinction alone make up to
/// 8 of a uniform sky.
constexpr double kEven = 10.0;
/// Samples of pixels without the object, which only the environment's detail needs.
constexpr int64_t kBackgroundSamples = 16;
/// Scattered paths of a pixel at least: pilots may not have seen what is rare.
constexpr int64_t kLeastScattered = 8;
/// A mirror sample costs one or two ray queries, the way through a clear body about fourteen, a scattered
/// path with its connections about twenty.
constexpr std::array<double, kPixelParts> kPartCost = {2.0, 14.0, 20.0};

/// The multiples of powers of 1 / phi, phi^6 = phi + 1 (Roberts, "The unreasonable effectiveness of
/// quasirandom sequences", 2018), shifted at random: each sample alone is uniform, together they are even.
class Sequence {
 public:
  static constexpr size_t kDimensions = 5;
  Sequence(Random& random, bool even) : even_(even) {
    for (double& x : shift_) x = random.uniform();
  }
  std::array<double, kDimensions> next(Random& random) {
    std::array<double, kDimensions> x{};
    if (!even_) {
      for (double& value : x) value = random.uniform();
      return x;
    }
    constexpr double kPhi = 1.1347241384015194;
    double step = 1.0;
    for (size_t i = 0; i < kDimensions; ++i) {
      step /= kPhi;
      const double value = shift_[i] + step * static_cast<double>(count_);
      x[i] = value - std::floor(value);
    }
    ++count_;
    return x;
  }

 private:
  std::array<double, kDimensions> shift_{};
  int64_t count_ = 0;
  bool even_;
};

double square(double x) {
  return x * x;
}

void add(StokesRgb& sum, const StokesRgb& term) {
  for (size_t i = 0; i < 3; ++i)
    for (size_t c = 0; c < 3; ++c) sum[i][c] += term[i][c];
}

void add_scaled(StokesRgb& sum, const StokesRgb& term, double scale) {
  for (size_t i = 0; i < 3; ++i)
    for (size_t c = 0; c < 3; ++c) sum[i][c] += term[i][c] * scale;
}

/// Draws samples of one pixel.
class PixelSampler {
 public:
  PixelSampler(const World& world, const Camera& camera, size_t pixel, Random& random, bool even,
               PathFaults& faults)
      : world_(world),
        camera_(camera),
        x_(static_cast<double>(pixel % static_cast<size_t>(camera.width))),
        y_(static_cast<double>(pixel / static_cast<size_t>(camera.width))),
        random_(random),
        sequence_(random, even),
        faults_(faults) {}

  PathSample next(const PathParts& parts) {
    const auto u = sequence_.next(random_);
    return sample_path_parts(world_, camera_.ray(x_ + u[0], y_ + u[1]), parts,
                             {.channel = u[2], .distance = u[3], .light = u[4]}, random_, faults_);
  }

 private:
  const World& world_;
  const Camera& camera_;
  double x_, y_;
  Random& random_;
  Sequence sequence_;
  PathFaults& faults_;
};

/// What pilot samples say of one pixel.
class PilotSums {
 public:
  void add(const PathSample& s) {
    ++count_;
    if (!s.hit) return;
    ++hits_;
    // The mirror part is what is reflected without further events; it comes with the unscattered part's
    // variance where more follow.
    const std::array<StokesRgb, kPixelParts> parts = {s.reflected, s.unscattered, s.scattered};
    for (size_t p = 0; p < kPixelParts; ++p) {
      for (size_t c = 0; c < 3; ++c) {
        for (size_t i = 0; i < 3; ++i) {
          sum_[p][i][c] += parts[p][i][c];
          for (size_t j = 0; j <= i; ++j) product_[p][c][i][j] += parts[p][i][c] * parts[p][j][c];
        }
      }
    }
  }

  PixelPilot result() const {
    PixelPilot pilot{.object = hits_ > 0, .whole = hits_ == count_};
    if (hits_ == 0) return pilot;
    const auto n = static_cast<double>(count_);
    for (size_t c = 0; c < 3; ++c) {
      std::array<double, 3> mean{};
      for (size_t p = 0; p < kPixelParts; ++p)
        for (size_t i = 0; i < 3; ++i) mean[i] += sum_[p][i][c] / n;
      pilot.light += std::min(mean[0], kWhite) / 3.0;
      const bool white = mean[0] > kWhite;
      const double dop = mean[0] > 0.0 ? std::hypot(mean[1], mean[2]) / mean[0] : 0.0;
      for (size_t p = 0; p < kPixelParts; ++p) {
        const auto covariance = [&](size_t i, size_t j) {
          return product_[p][c][std::max(i, j)][std::min(i, j)] / n - sum_[p][i][c] / n * (sum_[p][j][c] / n);
        };
        if (white || !(mean[0] > 0.0)) continue;
        pilot.s0[p] += std::max(0.0, covariance(0, 0)) / 3.0;
        // DoP = |(S1, S2)| / S0 along its direction (or the mean over directions where there is none).
        const double length = std::hypot(mean[1], mean[2]);
        const double u1 = length > 0.0 ? mean[1] / length : std::sqrt(0.5);
        const double u2 = length > 0.0 ? mean[2] / length : std::sqrt(0.5);
        const double variance = u1 * u1 * covariance(1, 1) + u2 * u2 * covariance(2, 2) +
                                2.0 * u1 * u2 * covariance(1, 2) + dop * dop * covariance(0, 0) -
                                2.0 * dop * (u1 * covariance(0, 1) + u2 * covariance(0, 2));
        pilot.dop[p] += std::max(0.0, variance) / square(mean[0]) / 3.0;
      }
    }
    return pilot;
  }

 private:
  static constexpr double kWhite = 2.0;
  int64_t count_ = 0, hits_ = 0;
  std::array<StokesRgb, kPixelParts> sum_{};
  std::array<std::array<std::array<std::array<double, 3>, 3>, 3>, kPixelParts> product_{};
};

/// One scene being rendered.
class Renderer {
 public:
  Renderer(const SceneModel& scene, const Camera& camera, const RenderOptions& options)
      : camera_(camera), options_(options), world_(scene.world()) {
    result_.width = camera.width;
    result_.height = camera.height;
    const auto pixels = static_cast<size_t>(camera.width) * static_cast<size_t>(camera.height);
    result_.image.resize(9 * pixels);
    result_.bsdf.resize(9 * pixels);
    result_.normal.resize(3 * pixels);
    result_.depth.resize(pixels);
    result_.coverage.resize(pixels);
    world_.bounded_queries = options.savings.bounded_queries;
    if (!world_.medium.empty() && options.savings.guide) {
      guide_.emplace(world_, scene.light, scene.low, scene.high,
                     Random(options.seed, Purpose::kRender, UINT32_MAX, options.number), options.guide);
      if (!options.savings.guide_by_need || guide_->concentration() > kEven) world_.guide = &*guide_;
    }
    result_.guided = world_.guide != nullptr;
  }

  SceneRender run() {
    const auto counts = options_.error > 0.0 ? plan() : even_counts();
    double scattered = 0.0, touched = 0.0;
    for_each_pixel([&](size_t pixel, PathFaults& faults) { render_pixel(pixel, counts[pixel], faults); });
    for (size_t i = 0; i < counts.size(); ++i) {
      if (!(result_.coverage[i] > 0.0F)) continue;
      touched += 1.0;
      scattered += static_cast<double>(counts[i][2]);
      const bool capped =
          options_.error > 0.0 && *std::max_element(counts[i].begin(), counts[i].end()) >= options_.most;
      result_.capped += capped ? 1 : 0;
    }
    result_.spp = touched > 0.0 ? scattered / touched : 0.0;
    return std::move(result_);
  }

 private:
  Random stream(size_t pixel, Pass pass) const {
    return {options_.seed, Purpose::kRender,
            static_cast<uint32_t>(pixel) * kPasses + static_cast<uint32_t>(pass), options_.number};
  }

  /// f(pixel, faults) for all pixels, a row a unit; faults joined in order.
  template <class F>
  void for_each_pixel(const F& f) {
    std::vector<PathFaults> faults(static_cast<size_t>(camera_.height));
    parallel_for(camera_.height, [&](int64_t row) {
      for (int64_t column = 0; column < camera_.width; ++column) {
        f(static_cast<size_t>(row * camera_.width + column), faults[static_cast<size_t>(row)]);
      }
    });
    for (const PathFaults& row : faults) {
      result_.faults.lost += row.lost;
      result_.faults.paths += row.paths;
    }
  }

  std::vector<PartCounts> even_counts() const {
    PartCounts all{};
    all.fill(std::max<int64_t>(options_.spp, 1));
    return std::vector<PartCounts>(result_.coverage.size(), all);
  }

  std::vector<PartCounts> plan() {
    std::vector<PixelPilot> pilots(result_.coverage.size());
    for_each_pixel([&](size_t pixel, PathFaults& faults) {
      Random random = stream(pixel, Pass::kPilot);
      PixelSampler sampler(world_, camera_, pixel, random, options_.savings.even_samples, faults);
      PilotSums sums;
      for (int64_t s = 0; s < options_.pilot; ++s) sums.add(sampler.next({}));
      pilots[pixel] = sums.result();
    });
    return plan_samples(pilots, camera_.width, camera_.height,
                        {.error = options_.error,
                         .dop_error = options_.dop_error,
                         .cost = kPartCost,
                         .least = {kBackgroundSamples, options_.spp, kLeastScattered},
                         .most = options_.most,
                         .parts = options_.savings.parts,
                         .pixels = options_.savings.pixels});
  }

  void render_pixel(size_t pixel, const PartCounts& counts, PathFaults& faults) {
    Random random = stream(pixel, Pass::kFinal);
    PixelSampler sampler(world_, camera_, pixel, random, options_.savings.even_samples, faults);
    StokesRgb image{}, bsdf{};
    // The mirror's samples are those that look for the object: pixels without it get them too.
    const int64_t mirrors =
        counts[0] > 0 ? counts[0] : (options_.savings.background ? kBackgroundSamples : options_.spp);
    Vec3 normal{};
    double depth = 0.0;
    int64_t hits = 0;
    const bool together = counts[0] == counts[1] && counts[0] == counts[2] && mirrors == counts[0];
    for (int64_t s = 0; s < mirrors; ++s) {
      const PathSample sample =
          sampler.next({.mirror = true, .unscattered = together, .scattered = together});
      if (!sample.hit) {
        for (size_t c = 0; c < 3; ++c) {
          image[0][c] += sample.background[c];
          bsdf[0][c] += sample.background[c];
        }
        continue;
      }
      add_full(image, sample, 1.0);
      add(bsdf, pure(sample));
      normal = normal + sample.normal;
      depth += sample.position.z / kCube;
      ++hits;
    }
    const double share = 1.0 / static_cast<double>(mirrors);
    for (StokesRgb* sum : {&image, &bsdf})
      for (Rgb& row : *sum)
        for (double& value : row) value *= share;
    if (!together) {
      add_part(counts[1], {.mirror = false, .unscattered = true, .scattered = false}, sampler, image, &bsdf);
      add_part(counts[2], {.mirror = false, .unscattered = false, .scattered = true}, sampler, image,
               nullptr);
    }
    if (!options_.savings.shared_paths) bsdf = separate_bsdf(pixel, mirrors, faults);
    write(pixel, image, bsdf);
    result_.coverage[pixel] = static_cast<float>(static_cast<double>(hits) * share);
    if (hits == 0) return;
    result_.depth[pixel] = static_cast<float>(depth / static_cast<double>(hits));
    const double length = norm(normal);
    const Vec3 n = length > 0.0 ? normal * (1.0 / length) : Vec3{0.0, 0.0, 1.0};
    result_.normal[3 * pixel] = static_cast<float>(n.x);
    result_.normal[3 * pixel + 1] = static_cast<float>(n.y);
    result_.normal[3 * pixel + 2] = static_cast<float>(n.z);
  }

  /// One more part of a pixel, over samples of its own.
  void add_part(int64_t count, const PathParts& parts, PixelSampler& sampler, StokesRgb& image,
                StokesRgb* bsdf) const {
    const double share = 1.0 / static_cast<double>(std::max<int64_t>(count, 1));
    for (int64_t s = 0; s < count; ++s) {
      const PathSample sample = sampler.next(parts);
      if (!sample.hit) continue;
      add_full(image, sample, share);
      if (bsdf != nullptr) add_scaled(*bsdf, pure(sample), share);
    }
  }

  /// The pure-BSDF image as a renderer makes it that knows nothing of the other: from the scene without the
  /// medium.
  StokesRgb separate_bsdf(size_t pixel, int64_t count, PathFaults& faults) const {
    World empty = world_;
    empty.medium = {};
    Random random = stream(pixel, Pass::kBsdf);
    PixelSampler sampler(empty, camera_, pixel, random, options_.savings.even_samples, faults);
    StokesRgb sum{};
    for (int64_t s = 0; s < count; ++s) {
      const PathSample sample = sampler.next({});
      if (!sample.hit) {
        for (size_t c = 0; c < 3; ++c) sum[0][c] += sample.background[c];
      } else {
        add(sum, pure(sample));
      }
    }
    for (Rgb& row : sum)
      for (double& value : row) value /= static_cast<double>(count);
    return sum;
  }

  const StokesRgb& pure(const PathSample& sample) const {
    return options_.bsdf == BsdfReading::kClear ? sample.clear : sample.mirror;
  }

  static void add_full(StokesRgb& image, const PathSample& sample, double share) {
    add_scaled(image, sample.reflected, share);
    add_scaled(image, sample.unscattered, share);
    add_scaled(image, sample.scattered, share);
  }

  void write(size_t pixel, const StokesRgb& image, const StokesRgb& bsdf) {
    for (size_t i = 0; i < 3; ++i) {
      for (size_t c = 0; c < 3; ++c) {
        result_.image[9 * pixel + 3 * i + c] = static_cast<float>(image[i][c]);
        result_.bsdf[9 * pixel + 3 * i + c] = static_cast<float>(bsdf[i][c]);
      }
    }
  }

  Camera camera_;
  RenderOptions options_;
  World world_;
  std::optional<Guide> guide_;
  SceneRender result_;
};

}  // namespace

SceneRender render_scene(const SceneModel& scene, const Camera& camera, const RenderOptions& options) {
  return Renderer(scene, camera, options).run();
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
