#include "data/render/light_paths.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/parallel.h"
#include "data/render/sequence.h"

namespace opaline::render {
namespace {

/// Paths that one thread traces in one go.
constexpr int64_t kBlock = 1024;
/// Blocks whose splats are kept until they are handed on in order.
constexpr int64_t kWave = 32;
/// Paths of less throughput than this are thinned out.
constexpr double kThin = 0.2;
/// A splat's light is guessed before the way to the camera is known: with a phase function of so much less
/// mean cosine, and so many times too bright rather than too dark.
constexpr double kBlunt = 0.7;
constexpr double kSafety = 2.0;
/// Streams of a scene that pixels do not use, and how many of them a pass has.
constexpr uint32_t kLightStreams = 0x80000000U;
constexpr uint32_t kLightPass = 0x20000000U;

/// Of the ball around the mesh.
double reach(const Mesh& mesh, const Vec3& centre) {
  double square = 0.0;
  for (const auto& v : mesh.vertices) {
    const Vec3 d = Vec3{v[0], v[1], v[2]} - centre;
    square = std::max(square, dot(d, d));
  }
  return std::sqrt(square) * (1.0 + 1e-6);
}

}  // namespace

LightTracer::LightTracer(const World& world, const Illumination& light, const Camera& camera, const Vec3& low,
                         const Vec3& high)
    : world_(world),
      camera_(camera),
      pixel_(std::pow(camera.pixel_size(camera.position.z - 1.0), 2)),
      emitter_(light, (low + high) * 0.5, reach(*world.geometry->mesh(), (low + high) * 0.5)),
      sights_(*world.geometry->mesh(), camera, world.index, low, high) {}

void LightTracer::trace(const Options& options, const Sink& sink, PathFaults& faults) const {
  Random shift(options.seed, Purpose::kRender, kLightStreams + options.pass * kLightPass, options.number);
  const Sequence<kNumbers> sequence(shift);
  const int64_t blocks = (options.paths + kBlock - 1) / kBlock;
  std::vector<std::vector<Splat>> splats(static_cast<size_t>(std::min(kWave, blocks)));
  std::vector<PathFaults> lost(splats.size());
  for (int64_t wave = 0; wave < blocks; wave += kWave) {
    const int64_t count = std::min(kWave, blocks - wave);
    parallel_for(count, [&](int64_t i) {
      const auto slot = static_cast<size_t>(i);
      splats[slot].clear();
      lost[slot] = {};
      const int64_t first = (wave + i) * kBlock, last = std::min(first + kBlock, options.paths);
      Random random(options.seed, Purpose::kRender,
                    kLightStreams + options.pass * kLightPass + 1 + static_cast<uint32_t>(wave + i),
                    options.number);
      for (int64_t path = first; path < last; ++path) {
        trace_path(sequence.at(path), options.faint, random, splats[slot], lost[slot]);
      }
    });
    for (int64_t i = 0; i < count; ++i) {
      sink(splats[static_cast<size_t>(i)]);
      faults.lost += lost[static_cast<size_t>(i)].lost;
      faults.paths += lost[static_cast<size_t>(i)].paths;
    }
  }
}

void LightTracer::trace_path(const std::array<double, kNumbers>& u, double faint, Random& random,
                             std::vector<Splat>& splats, PathFaults& faults) const {
  const LightRay light = emitter_.emit(std::span(u).first<Emitter::kDimensions>());
  const FlightNumbers first{u[Emitter::kDimensions], u[Emitter::kDimensions + 1]};
  const double brightest = largest(light.flux);
  if (!(brightest > 0.0)) return;
  Walk walk(world_, random);
  Ray ray{.origin = light.origin, .direction = light.direction, .inside = false};
  Response<1> response = scalar_response(ray.direction);
  Rgb beta = light.flux;
  const double thin = kThin * brightest;
  for (bool scattered = false;; scattered = true) {
    double length = 0.0;
    const End end = walk.fly(ray, response, beta, length, scattered ? nullptr : &first);
    if (end == End::kLost) ++faults.lost;
    if (end != End::kScattered) break;
    if (!scattered) ++faults.paths;
    // Unpolarised from here on, but it came polarised.
    beta = scaled(beta, scattered ? response.scattered[0][0] : response.pure[0][0]);
    beta = product(beta, world_.medium.albedo);
    join(ray, beta, faint, random, splats);

    const double throughput = largest(beta);
    if (!(throughput > 0.0)) return;
    if (throughput < thin) {
      const double go_on = throughput / thin;
      if (!(random.uniform() < go_on)) return;
      beta = scaled(beta, 1.0 / go_on);
    }
    const double cosine = sample_henyey_greenstein(random.uniform(), world_.medium.g);
    ray.direction = around(ray.direction, cosine, 2.0 * std::numbers::pi * random.uniform());
    response = scalar_response(ray.direction);
  }
}

/// Sends light of flux `beta`, which scatters where the ray ends, to the camera.
void LightTracer::join(const Ray& ray, const Rgb& beta, double faint, Random& random,
                       std::vector<Splat>& splats) const {
  const double shortest = sights_.shortest(ray.origin);
  if (!std::isfinite(shortest)) return;
  // What will come of it, about: most of what is faint need not even be looked at.
  const Vec3 towards = camera_.position - ray.origin;
  const double distance2 = dot(towards, towards), n2 = world_.index * world_.index;
  double kept = 1.0;
  if (faint > 0.0) {
    const double cosine = dot(ray.direction, towards) / std::sqrt(distance2);
    const double around = henyey_greenstein(cosine, kBlunt * world_.medium.g);
    const double likely =
        mean(product(beta, world_.medium.transmittance(shortest))) * around / (n2 * pixel_ * distance2);
    kept = std::min(1.0, kSafety * likely / faint);
    if (kept < 1.0 && !(random.uniform() < kept)) return;
  }
  sights_.for_each(ray.origin, [&](const Sight& sight) {
    const double phase = henyey_greenstein(-dot(ray.direction, sight.inside), world_.medium.g);
    // Radiance is flux per area and solid angle; it falls by n^2 as the beam widens on its way out.
    const double density = phase / (n2 * sight.section * kept);
    Rgb light = scaled(product(beta, world_.medium.transmittance(sight.length)), density);
    const Fresnel f = fresnel(sight.cosine, world_.index);
    const double brightness = mean(light) * (1.0 - f.reflectance());
    if (brightness < faint) {
      const double keep = brightness / faint;
      if (!(random.uniform() < keep)) return;
      light = scaled(light, 1.0 / keep);
    }
    Hit hit{.distance = 0.0, .position = sight.surface, .normal = sight.normal};
    const Geometry& geometry = *world_.geometry;
    if (geometry.occluded(geometry.start(hit, sight.inside, true), sight.inside, true, sight.length) ||
        geometry.occluded(geometry.start(hit, -sight.direction, false), -sight.direction, false, kInfinity)) {
      return;
    }
    Response<3> rows = camera_response(camera_.ray(sight.x, sight.y).axis);
    rows.transmit({.direction = sight.direction, .normal = sight.normal, .fresnel = f});
    const Rgb column = first_column(rows.scattered);
    Splat splat{
        .pixel = static_cast<uint32_t>(static_cast<int>(sight.y) * camera_.width + static_cast<int>(sight.x)),
        .rows = {},
        .light = {}};
    for (size_t i = 0; i < 3; ++i) {
      splat.rows[i] = static_cast<float>(column[i]);
      splat.light[i] = static_cast<float>(light[i]);
    }
    splats.push_back(splat);
  });
}

}  // namespace opaline::render
