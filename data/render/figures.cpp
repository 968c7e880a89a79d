#include "data/render/figures.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/error.h"
#include "data/render/guide.h"
#include "data/render/moments.h"

namespace opaline::render {
namespace {

constexpr double kPi = std::numbers::pi;

/// `f(d)` at the texels of a latitude-longitude grid.
template <class F>
Environment environment_of(const F& f, int64_t height) {
  std::vector<Rgb> texels;
  texels.reserve(static_cast<size_t>(2 * height * height));
  for (int64_t i = 0; i < height; ++i) {
    for (int64_t j = 0; j < 2 * height; ++j) {
      const double latitude = (static_cast<double>(i) + 0.5) / static_cast<double>(height) * kPi;
      const double longitude =
          ((static_cast<double>(j) + 0.5) / static_cast<double>(2 * height) - 0.5) * 2 * kPi;
      const double s = std::sin(latitude);
      const double v = f(Vec3{s * std::sin(longitude), std::cos(latitude), -s * std::cos(longitude)});
      texels.push_back({v, v, v});
    }
  }
  return {std::move(texels), 2 * height};
}

double band_norm(const Harmonics& h, size_t band) {
  double sum = 0.0;
  for (size_t k = band * band; k < (band + 1) * (band + 1); ++k) sum += h[k] * h[k];
  return std::sqrt(sum);
}

Figure exact(std::string name, double value, double expected, double tolerance) {
  return {std::move(name), value, 0.0, expected, tolerance};
}

Figure sampled(std::string name, const Estimate& e, double expected, double scale = 1.0) {
  return {std::move(name), scale * e.mean, scale * e.standard_error, expected, 0.0};
}

}  // namespace

std::vector<Figure> validate_hg(double g, int64_t paths, uint64_t seed) {
  if (!(std::abs(g) < 1.0)) fail_usage("validate hg", "g = {} is not in (-1, 1)", g);
  if (paths < 2 * kPathsOfBlock) {
    fail_usage("validate hg", "paths = {} is not at least {}: blocks give the error", paths,
               2 * kPathsOfBlock);
  }
  // A block is one sample of its mean: strata make it far more exact than as many numbers without them.
  const auto moments =
      run_blocks<Moments<2>>(paths, seed, [g](Random& random, Moments<2>& part, int64_t count) {
        const Vec3 before = around({0, 0, 1}, random.uniform(-1, 1), 2 * kPi * random.uniform());
        double first = 0.0, second = 0.0;
        for (int64_t i = 0; i < count; ++i) {
          const double u = (static_cast<double>(i) + random.uniform()) / static_cast<double>(count);
          const Vec3 after = around(before, sample_henyey_greenstein(u, g), 2 * kPi * random.uniform());
          const double cosine = dot(before, after);
          first += cosine;
          second += 1.5 * cosine * cosine - 0.5;
        }
        const auto n = static_cast<double>(count);
        part.add({first / n, second / n});
      });
  std::vector<Figure> figures = {sampled("mean cosine", moments.estimate(0), g),
                                 sampled("second Legendre moment", moments.estimate(1), g * g)};
  // The density, by midpoints of a variable that is dense where the peak is: 1 - |cosine| side = t^4.
  constexpr int kSteps = 200'000;
  double integral = 0.0, first = 0.0, second = 0.0;
  for (int i = 0; i < kSteps; ++i) {
    const double t = (i + 0.5) / kSteps;
    const double cosine = std::copysign(1.0, g) * (1.0 - 2.0 * t * t * t * t);
    const double weight = henyey_greenstein(cosine, g) * 2.0 * kPi * 8.0 * t * t * t / kSteps;
    integral += weight;
    first += cosine * weight;
    second += (1.5 * cosine * cosine - 0.5) * weight;
  }
  figures.push_back(exact("integral of the density", integral, 1.0, 1e-6));
  figures.push_back(exact("mean cosine of the density", first, g, 1e-6));
  figures.push_back(exact("second moment of the density", second, g * g, 1e-6));
  return figures;
}

std::vector<Figure> validate_sh(int rotations, uint64_t seed) {
  constexpr int64_t kHeight = 1024;
  constexpr std::array<double, 3> kLobe = {.88623, 1.02333, .49542};
  constexpr double kDigit = 1e-5;
  std::vector<Figure> figures;
  const Harmonics constant = Environment(Rgb{1.0, 1.0, 1.0}).project()[0];
  figures.push_back(exact("L = 1, c00", constant[0], 3.54491, 0.51e-5));
  double rest = 0.0;
  for (size_t k = 1; k < constant.size(); ++k) rest = std::max(rest, std::abs(constant[k]));
  figures.push_back(exact("L = 1, largest of the others", rest, 0.0, 1e-4));

  const Harmonics lobe =
      environment_of([](const Vec3& d) { return std::max(0.0, d.z); }, kHeight).project()[0];
  constexpr std::array<size_t, 3> kZonal = {0, 2, 6};
  rest = 0.0;
  for (size_t k = 0; k < lobe.size(); ++k) {
    if (std::find(kZonal.begin(), kZonal.end(), k) == kZonal.end()) rest = std::max(rest, std::abs(lobe[k]));
  }
  for (size_t band = 0; band < 3; ++band) {
    figures.push_back(
        exact(fmt::format("max(0, z), band {}", band), lobe[kZonal[band]], kLobe[band], kDigit));
  }
  figures.push_back(exact("max(0, z), largest of the others", rest, 0.0, 1e-4));

  Random random(seed, Purpose::kValidate, 2, 0);
  for (int i = 0; i < rotations; ++i) {
    const Vec3 axis = around({0, 0, 1}, random.uniform(-1, 1), 2 * kPi * random.uniform());
    const Harmonics turned =
        environment_of([&axis](const Vec3& d) { return std::max(0.0, dot(d, axis)); }, kHeight).project()[0];
    for (size_t band = 0; band < 3; ++band) {
      figures.push_back(exact(
          fmt::format("turned to ({:+.2f}, {:+.2f}, {:+.2f}), norm of band {}", axis.x, axis.y, axis.z, band),
          band_norm(turned, band), kLobe[band], kDigit));
    }
  }
  return figures;
}

std::vector<Figure> validate_flash(int64_t paths, uint64_t seed) {
  constexpr double kExpected = 2.454, kRadiance = 50.0;
  Illumination light;
  light.flash = {.centre = {0.0, 0.0, 0.8}, .radius = 0.1, .radiance = kRadiance};
  std::vector<Figure> figures = {exact("formula", light.flash.irradiance({}), kExpected, 0.51e-3)};

  const auto looked =
      run_blocks<Moments<1>>(paths, seed, [&light](Random& r, Moments<1>& part, int64_t count) {
        for (int64_t i = 0; i < count; ++i) {
          const Vec3 d = around({0, 0, 1}, std::sqrt(1.0 - r.uniform()), 2 * kPi * r.uniform());
          part.add({light.radiance({}, d)[0]});
        }
      });
  // The figure has four digits; the closed form has them all.
  const double closed = kPi * kRadiance * (0.1 / 0.8) * (0.1 / 0.8);
  figures.push_back(sampled("over the hemisphere", looked.estimate(0), closed, kPi));

  // One mean free path is 1e-6 m: light leaves where it enters, and a hundred of them are a half-space.
  constexpr double kAlbedo = 0.9, kCosine = 0.6;
  const auto half_space = make_slab_geometry(1e-4);
  World world{.geometry = half_space.get(),
              .light = &light,
              .medium = {.sigma_t = {1e6, 1e6, 1e6}, .albedo = {kAlbedo, kAlbedo, kAlbedo}, .g = 0.0},
              .index = 1.0};
  const Vec3 box{1e-5, 1e-5, 1e-5};
  const Guide guide(world, light, -box, box, Random(seed, Purpose::kValidate, UINT32_MAX));
  world.guide = &guide;
  const Vec3 direction{std::sqrt(1.0 - kCosine * kCosine), 0.0, -kCosine};
  const CameraRay ray{-direction, direction, {0.0, 1.0, 0.0}};
  const auto traced =
      run_blocks<Moments<1>>(paths / 64, seed, [&](Random& r, Moments<1>& part, int64_t count) {
        PathFaults faults;
        for (int64_t i = 0; i < count; ++i) {
          const PathSample s = sample_path(world, ray, r, faults);
          part.add({s.reflected[0][0] + s.unscattered[0][0] + s.scattered[0][0]});
        }
      });
  // The flash covers cosines from sqrt(1 - (r/d)^2) to 1, each c with weight c.
  const ChandrasekharH h(kAlbedo);
  const double low = std::sqrt(1.0 - 1.0 / 64.0);
  double brdf = 0.0, total = 0.0;
  for (int i = 0; i < 100; ++i) {
    const double c = low + (1.0 - low) * (i + 0.5) / 100.0;
    brdf += c * h.brdf(c, kCosine);
    total += c;
  }
  figures.push_back(sampled("through a half-space of albedo 0.9", traced.estimate(0), closed, total / brdf));
  return figures;
}

ChandrasekharH::ChandrasekharH(double albedo) : albedo_(albedo) {
  if (!(albedo >= 0.0 && albedo < 1.0)) fail_usage("validate", "albedo = {} is not in [0, 1)", albedo);
  // Midpoints in t with cosine = t^2, which tames the slope at 0.
  constexpr int kNodes = 400;
  for (int i = 0; i < kNodes; ++i) {
    const double t = (i + 0.5) / kNodes;
    cosines_.push_back(t * t);
    weights_.push_back(2.0 * t / kNodes);
  }
  values_.assign(kNodes, 1.0);
  // 1 / H(mu) = sqrt(1 - a) + a/2 integral of mu' H(mu') / (mu + mu') (Chandrasekhar, Radiative Transfer, V).
  for (double change = 1.0; change > 1e-12;) {
    change = 0.0;
    std::vector<double> next;
    next.reserve(values_.size());
    for (const double c : cosines_) next.push_back((*this)(c));
    for (size_t i = 0; i < next.size(); ++i) change = std::max(change, std::abs(next[i] - values_[i]));
    values_ = std::move(next);
  }
}

double ChandrasekharH::operator()(double cosine) const {
  double sum = 0.0;
  for (size_t i = 0; i < values_.size(); ++i) {
    sum += weights_[i] * cosines_[i] * values_[i] / (cosine + cosines_[i]);
  }
  return 1.0 / (std::sqrt(1.0 - albedo_) + 0.5 * albedo_ * sum);
}

double ChandrasekharH::brdf(double cosine_in, double cosine_out) const {
  return albedo_ / (4.0 * kPi) * (*this)(cosine_in) * (*this)(cosine_out) / (cosine_in + cosine_out);
}

}  // namespace opaline::render
