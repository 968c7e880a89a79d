#include "data/render/render.h"

#include <algorithm>
#include <cmath>
#include <optional>

#include "core/parallel.h"
#include "data/render/light_paths.h"
#include "data/render/pilot.h"
#include "data/render/plan.h"
#include "data/render/sequence.h"

namespace opaline::render {
namespace {

/// Streams of one pixel, besides its number: pilot and final samples must not share numbers.
enum class Pass : uint32_t { kFinal = 0, kPilot = 1, kBsdf = 2 };
constexpr uint32_t kPasses = 4;
/// Light no denser than this (data/render/guide.h) needs no guide: refraction and extinction alone make up to
/// 8 of a uniform sky.
constexpr double kEven = 10.0;
constexpr int64_t kFewestPhotons = 4096;
/// Samples of pixels without the object, which only the environment's detail needs.
constexpr int64_t kBackgroundSamples = 16;
/// Scattered paths of a pixel at least: pilots may not have seen what is rare.
constexpr int64_t kLeastScattered = 8;
/// A mirror sample costs one or two ray queries, the way through a clear body about fourteen, a scattered
/// path with its connections about twenty.
constexpr std::array<double, kPixelParts> kPartCost = {2.0, 14.0, 20.0};
constexpr double kLightPathCost = 20.0;
/// With as many samples of each part: light paths are the noisier part and the cheaper one.
constexpr int64_t kLightPathsPerSample = 2;
/// Splats are thinned out that bring less than this share of what light comes in on the average.
constexpr double kFaintShare = 0.5;

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
        sequence_(random),
        even_(even),
        faults_(faults) {}

  PathSample next(const PathParts& parts) {
    const auto u = even_ ? sequence_.at(count_++) : uniform<kNumbers>(random_);
    return sample_path_parts(world_, camera_.ray(x_ + u[0], y_ + u[1]), parts,
                             FirstNumbers(std::span(u).last<FirstNumbers::kCount>()), random_, faults_);
  }

 private:
  static constexpr size_t kNumbers = 2 + FirstNumbers::kCount;

  const World& world_;
  const Camera& camera_;
  double x_, y_;
  Random& random_;
  Sequence<kNumbers> sequence_;
  int64_t count_ = 0;
  bool even_;
  PathFaults& faults_;
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
      const Random random(options.seed, Purpose::kRender, UINT32_MAX, options.number);
      const auto make = [&](int64_t count) {
        guide_.emplace(world_, scene.light, scene.low, scene.high, random, GuideOptions{.photons = count});
      };
      // A few sub-paths tell whether more are worth their time.
      if (options.savings.guide_by_need) make(kFewestPhotons);
      const bool even = options.savings.guide_by_need && guide_->concentration() <= kEven;
      if (!even && options.savings.light_paths && world_.geometry->mesh() != nullptr) {
        tracer_.emplace(world_, scene.light, camera_, scene.low, scene.high);
        if (!tracer_->possible()) tracer_.reset();
      }
      if (!even) {
        make(photons());
        world_.guide = &*guide_;
      }
    }
    result_.guided = world_.guide != nullptr;
  }

  SceneRender run() {
    const SamplePlan plan = options_.error > 0.0 ? planned() : even();
    const std::vector<PartCounts>& counts = plan.pixels;
    if (tracer_) trace_light(plan.light_paths);
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
  /// A photon costs about a quarter of a camera path. In 16^3 cells more than the most bring nothing; with
  /// few the guide misses light that then makes outliers. Objects fill about a quarter of a picture.
  int64_t photons() const {
    constexpr int64_t kMost = 131072;
    if (options_.photons > 0) return options_.photons;
    if (options_.error > 0.0) return kMost;
    return std::clamp(camera_.width * camera_.height * options_.spp / 4, kFewestPhotons, kMost);
  }

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

  SamplePlan even() {
    PartCounts all{};
    all.fill(std::max<int64_t>(options_.spp, 1));
    if (tracer_) pilot_light(kFewestPhotons);
    return {std::vector<PartCounts>(result_.coverage.size(), all), all[0] * kLightPathsPerSample * touched()};
  }

  /// Pixels that the object covers, about.
  int64_t touched() const {
    int64_t count = 0;
    for (int y = 0; y < camera_.height; ++y) {
      for (int x = 0; x < camera_.width; ++x) {
        const CameraRay ray = camera_.ray(x + 0.5, y + 0.5);
        Hit hit;
        count += world_.geometry->intersect(ray.origin, ray.direction, kInfinity, hit) ? 1 : 0;
      }
    }
    return count;
  }

  /// Light paths whose splats are looked at, not kept. Sets what the others' may leave out.
  std::vector<LightPilot> pilot_light(int64_t paths) {
    std::vector<LightPilot> pilots(result_.coverage.size());
    double sum = 0.0, square = 0.0;
    tracer_->trace(
        {.paths = paths, .seed = options_.seed, .pass = 1, .number = options_.number},
        [&](std::span<const Splat> splats) {
          for (const Splat& splat : splats) {
            pilots[splat.pixel].add(splat);
            const double s0 = splat.brightness();
            sum += s0;
            square += s0 * s0;
          }
        },
        result_.faults);
    faint_ = sum > 0.0 ? kFaintShare * square / sum : 0.0;
    return pilots;
  }

  void trace_light(int64_t planned) {
    // Some at least: pilots may not have seen what there is.
    const int64_t paths =
        std::clamp(planned, kFewestPhotons, std::max(kFewestPhotons, options_.most * touched()));
    light_.resize(result_.coverage.size());
    tracer_->trace(
        {.paths = paths, .faint = faint_, .seed = options_.seed, .number = options_.number},
        [this](std::span<const Splat> splats) {
          for (const Splat& splat : splats)
            for (size_t i = 0; i < 3; ++i)
              for (size_t c = 0; c < 3; ++c)
                light_[splat.pixel][i][c] += double{splat.rows[i]} * double{splat.light[c]};
        },
        result_.faults);
    for (StokesRgb& pixel : light_)
      for (Rgb& row : pixel) row = scaled(row, 1.0 / static_cast<double>(paths));
    result_.light_paths = paths;
  }

  SamplePlan planned() {
    const int64_t paths = tracer_ ? options_.pilot * touched() : 0;
    std::vector<LightPilot> light(result_.coverage.size());
    if (tracer_) light = pilot_light(paths);
    std::vector<PixelPilot> pilots(result_.coverage.size());
    for_each_pixel([&](size_t pixel, PathFaults& faults) {
      Random random = stream(pixel, Pass::kPilot);
      PixelSampler sampler(world_, camera_, pixel, random, options_.savings.even_samples, faults);
      CameraPilot camera;
      for (int64_t s = 0; s < options_.pilot; ++s) camera.add(sampler.next({.direct = !tracer_}));
      LightPilot around;
      const double pixels = add_around(light, pixel, around);
      pilots[pixel] = camera.result(light[pixel], around, pixels, paths);
    });
    return plan_samples(pilots, camera_.width, camera_.height,
                        {.error = options_.error,
                         .dop_error = options_.dop_error,
                         .cost = kPartCost,
                         .light_path_cost = kLightPathCost,
                         .least = {kBackgroundSamples, options_.spp, kLeastScattered},
                         .most = options_.most,
                         .parts = options_.savings.parts,
                         .pixels = options_.savings.pixels});
  }

  /// Sums what the pixel and its neighbours got; returns how many they are.
  double add_around(const std::vector<LightPilot>& light, size_t pixel, LightPilot& sum) const {
    const auto width = static_cast<size_t>(camera_.width), height = static_cast<size_t>(camera_.height);
    const size_t x = pixel % width, y = pixel / width;
    double count = 0.0;
    for (size_t j = y - std::min<size_t>(y, 1); j <= std::min(y + 1, height - 1); ++j) {
      for (size_t i = x - std::min<size_t>(x, 1); i <= std::min(x + 1, width - 1); ++i) {
        sum.add(light[j * width + i]);
        count += 1.0;
      }
    }
    return count;
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
    const bool direct = !tracer_;
    const bool together = counts[0] == counts[1] && counts[0] == counts[2] && mirrors == counts[0];
    for (int64_t s = 0; s < mirrors; ++s) {
      const PathSample sample =
          sampler.next({.mirror = true, .unscattered = together, .scattered = together, .direct = direct});
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
      add_part(counts[2], {.mirror = false, .unscattered = false, .scattered = true, .direct = direct},
               sampler, image, nullptr);
    }
    if (tracer_) add(image, light_[pixel]);
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
  std::optional<LightTracer> tracer_;  // of scattered light that the camera sees straight through the surface
  double faint_ = 0.0;
  std::vector<StokesRgb> light_;  // that it has found
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
