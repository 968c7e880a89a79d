#include "data/render/validate.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <numbers>

#include "core/error.h"
#include "data/render/moments.h"

namespace opaline::render {
namespace {

constexpr double kPi = std::numbers::pi;

/// Radiance 1 from above in the first colour, from below in the second.
class Hemispheres final : public Light {
 public:
  Rgb radiance(const Vec3&, const Vec3& d) const override {
    return d.z > 0.0 ? Rgb{1.0, 0.0, 0.0} : Rgb{0.0, 1.0, 0.0};
  }
  Rgb background(const Vec3& d) const override { return radiance({}, d); }
};

Illumination uniform_light() {
  Illumination light;
  light.environment = Environment(Rgb{1.0, 1.0, 1.0});
  light.flash.radiance = 1.0;
  return light;
}

/// A ray that meets the plane z = 0 from above at the given angle; 0 degrees of the polariser lie across the
/// plane of incidence.
CameraRay ray_at(double cosine) {
  const double sine = std::sqrt(std::max(0.0, 1.0 - cosine * cosine));
  const Vec3 direction{sine, 0.0, -cosine};
  return {Vec3{} - direction, direction, {0.0, 1.0, 0.0}};
}

Vec3 surface_axis(const Vec3& normal, const Vec3& direction) {
  const Vec3 s = cross(normal, direction);
  return norm(s) > 1e-9 ? normalised(s) : basis_around(direction).first;
}

}  // namespace

SlabResult validate_slab(const SlabOptions& o) {
  const auto check = [](bool good, const char* name, double value, const char* expected) {
    if (!good) fail_usage("validate slab", "{} = {} is not {}", name, value, expected);
  };
  check(o.albedo >= 0.0 && o.albedo <= 1.0, "albedo", o.albedo, "in [0, 1]");
  check(o.g > -1.0 && o.g < 1.0, "g", o.g, "in (-1, 1)");
  check(o.tau > 0.0, "tau", o.tau, "positive or inf");
  check(o.index >= 1.0 && o.index <= 4.0, "n", o.index, "in [1, 4]");
  check(o.paths >= 2, "paths", static_cast<double>(o.paths), "at least 2");
  check(std::isfinite(o.tau) || o.albedo < 1.0, "albedo", o.albedo, "below 1, as a half-space needs");

  const auto geometry = make_slab_geometry(o.tau);  // one metre is one mean free path
  const Hemispheres light;
  const World world{
      .geometry = geometry.get(),
      .light = &light,
      .medium = {.sigma_t = {1.0, 1.0, 1.0}, .albedo = {o.albedo, o.albedo, o.albedo}, .g = o.g},
      .index = o.index};
  const auto begin = std::chrono::steady_clock::now();
  const auto sums =
      run_blocks<Moments<3>>(o.paths, o.seed, [&](Random& random, Moments<3>& part, int64_t paths) {
        PathFaults faults;
        for (int64_t i = 0; i < paths; ++i) {
          // Lambertian light: the square of the cosine is uniform in (0, 1].
          const double cosine = o.lambertian ? std::sqrt(1.0 - random.uniform()) : 1.0;
          const PathSample s = sample_path(world, ray_at(cosine), random, faults);
          part.add({s.unscattered[0][0] + s.scattered[0][0],
                    s.reflected[0][1] + s.unscattered[0][1] + s.scattered[0][1], s.reflected[0][0]});
        }
      });
  const double seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  return {.reflected = sums.estimate(0),
          .transmitted = sums.estimate(1),
          .specular = sums.estimate(2).mean,
          .paths_per_second = static_cast<double>(o.paths) / std::max(seconds, 1e-9)};
}

FurnaceResult validate_furnace(const SceneRanges& ranges, const FurnaceOptions& options) {
  const Camera camera;
  SceneModel scene = draw_scene(ranges, camera, options.seed, options.number);
  scene.medium.albedo = {1.0, 1.0, 1.0};
  scene.light = uniform_light();
  World world = scene.world();
  const Guide guide(world, scene.light, scene.low, scene.high,
                    Random(options.seed, Purpose::kValidate, UINT32_MAX, options.number));
  world.guide = &guide;

  // f(sample, cosine) for rays that meet the object.
  const auto shoot = [&camera](const World& w, Random& random, int64_t paths, PathFaults& faults,
                               const auto& f) {
    for (int64_t done = 0; done < paths;) {
      CameraRay ray = camera.ray(camera.width * random.uniform(), camera.height * random.uniform());
      Hit hit;
      if (!w.geometry->intersect(ray.origin, ray.direction, kInfinity, hit)) continue;
      ++done;
      ray.axis = surface_axis(hit.normal, ray.direction);
      f(sample_path(w, ray, random, faults), std::clamp(-dot(ray.direction, hit.normal), 0.0, 0.999));
    }
  };
  struct Sums {
    Moments<1> all;
    std::array<Moments<1>, 4> bins;
    PathFaults faults;
    void join(const Sums& other) {
      all.join(other.all);
      for (size_t b = 0; b < bins.size(); ++b) bins[b].join(other.bins[b]);
      faults.lost += other.faults.lost;
      faults.paths += other.faults.paths;
    }
  };
  const auto full =
      run_blocks<Sums>(options.paths, options.seed, [&](Random& random, Sums& part, int64_t paths) {
        shoot(world, random, paths, part.faults, [&part](const PathSample& s, double cosine) {
          // One colour: the three share their paths.
          const double s0 = s.reflected[0][1] + s.unscattered[0][1] + s.scattered[0][1];
          part.all.add({s0});
          part.bins[static_cast<size_t>(4.0 * cosine)].add({s0});
        });
      });
  World empty = world;
  empty.medium = {};
  const auto clear = run_blocks<Moments<3>>(
      6 * options.paths, options.seed, [&](Random& random, Moments<3>& part, int64_t paths) {
        PathFaults ignored;
        shoot(empty, random, paths, ignored, [&part](const PathSample& s, double) {
          part.add({s.clear[0][1], s.clear[1][1], s.clear[2][1]});
        });
      });
  FurnaceResult result{.object = scene.object,
                       .s0 = full.all.estimate(0),
                       .clear = {clear.estimate(0), clear.estimate(1), clear.estimate(2)},
                       .by_cosine = {},
                       .faults = full.faults};
  for (size_t b = 0; b < 4; ++b) result.by_cosine[b] = full.bins[b].estimate(0);
  return result;
}

bool Figure::passes() const {
  return std::abs(value - expected) <= std::max(tolerance, 3.0 * standard_error);
}

std::vector<Figure> validate_fresnel(int64_t paths, uint64_t seed) {
  struct Row {
    double angle, rs, rp, specular, diffuse;
  };
  // From the equations at n = 1.5046; the degrees of polarisation also by Atkinson and Hancock's closed
  // forms.
  constexpr std::array<Row, 5> kTable = {{{30, .058578, .025666, .39068, .01718},
                                          {45, .093099, .008667, .82966, .04448},
                                          {60, .178160, .001737, .98069, .09693},
                                          {75, .401337, .106501, .58057, .19759},
                                          {85, .733595, .493019, .19613, .31107}}};
  const Illumination light = uniform_light();
  const auto half_space = make_slab_geometry(kInfinity);
  const World black{.geometry = half_space.get(),
                    .light = &light,
                    .medium = {.sigma_t = {1e3, 1e3, 1e3}, .albedo = {}, .g = 0.0}};
  const auto layer = make_slab_geometry(2.0);
  const World white{.geometry = layer.get(),
                    .light = &light,
                    .medium = {.sigma_t = {1.0, 1.0, 1.0}, .albedo = {1.0, 1.0, 1.0}, .g = 0.0}};

  std::vector<Figure> figures;
  PathFaults faults;
  Random random(seed, Purpose::kValidate, 1, 0);
  for (const Row& row : kTable) {
    const double angle = row.angle * kPi / 180.0;
    const CameraRay ray = ray_at(std::cos(angle));
    const StokesRgb reflected = sample_path(black, ray, random, faults).reflected;
    const double s0 = reflected[0][0], s1 = reflected[1][0];
    const auto exact = [&](const char* name, double value, double expected, double unit) {
      figures.push_back(
          {fmt::format("{} at {} degrees", name, row.angle), value, 0.0, expected, 0.51 * unit});
    };
    exact("Rs", s0 + s1, row.rs, 1e-6);
    exact("Rp", s0 - s1, row.rp, 1e-6);
    exact("specular DoP", s1 / s0, row.specular, 1e-5);
    exact("specular DoP, closed form", specular_dop(angle, kRefractiveIndex), row.specular, 1e-5);
    // Any path that scatters leaves with the same degree of polarisation: a few are enough.
    double diffuse0 = 0.0, diffuse1 = 0.0;
    for (int i = 0; i < 64; ++i) {
      const StokesRgb scattered = sample_path(white, ray, random, faults).scattered;
      diffuse0 += scattered[0][0];
      diffuse1 += scattered[1][0];
    }
    exact("diffuse DoP", -diffuse1 / diffuse0, row.diffuse, 1e-5);
    exact("diffuse DoP, closed form", diffuse_dop(angle, kRefractiveIndex), row.diffuse, 1e-5);
  }
  const double normal = fresnel(1.0, kRefractiveIndex).reflectance();
  figures.push_back({"normal reflectance", normal, 0.0, .040590, 5.1e-7});
  // The angles where Rp vanishes and where total reflection begins, from the equations by bisection.
  const auto bisect = [](const auto& beyond) {
    double low = 0.0, high = 0.5 * kPi;
    for (int i = 0; i < 60; ++i) {
      const double middle = 0.5 * (low + high);
      (beyond(middle) ? high : low) = middle;
    }
    return low * 180.0 / kPi;
  };
  const double brewster = bisect([](double a) {
    return fresnel(std::cos(a + 1e-6), kRefractiveIndex).reflect_p >
           fresnel(std::cos(a - 1e-6), kRefractiveIndex).reflect_p;
  });
  figures.push_back({"Brewster's angle, degrees", brewster, 0.0, 56.391, 5.1e-4});
  const double critical = bisect([](double a) { return fresnel(std::cos(a), 1.0 / kRefractiveIndex).total; });
  figures.push_back({"critical angle, degrees", critical, 0.0, 41.654, 5.1e-4});
  const auto outside = run_blocks<Moments<1>>(paths, seed, [&](Random& r, Moments<1>& part, int64_t count) {
    PathFaults ignored;
    for (int64_t i = 0; i < count; ++i) {
      part.add({sample_path(black, ray_at(std::sqrt(1.0 - r.uniform())), r, ignored).reflected[0][0]});
    }
  });
  figures.push_back({"average reflectance outside", outside.estimate(0).mean,
                     outside.estimate(0).standard_error, .092453, 0.0});
  const auto inside = run_blocks<Moments<1>>(paths, seed, [&](Random& r, Moments<1>& part, int64_t count) {
    for (int64_t i = 0; i < count; ++i) {
      part.add({fresnel(std::sqrt(1.0 - r.uniform()), 1.0 / kRefractiveIndex).reflectance()});
    }
  });
  figures.push_back({"average reflectance inside", inside.estimate(0).mean, inside.estimate(0).standard_error,
                     .599108, 0.0});
  return figures;
}

}  // namespace opaline::render
