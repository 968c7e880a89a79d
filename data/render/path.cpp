#include "data/render/path.h"

#include <algorithm>
#include <cmath>
#include <numbers>

namespace opaline::render {
namespace {

/// Share of the pixel's light that an unscattered branch has to carry to be followed for sure.
constexpr double kSplit = 0.004;
/// Paths of less throughput than this are thinned out.
constexpr double kThin = 0.2;
/// Light that finds its way out to a scattering is thinned out where less than this of it comes through.
constexpr double kDark = 0.05;
/// Ways of the camera's ray inside are thinned out where less than this of a pixel's light comes along them.
constexpr double kFaint = 0.1;

double sum(const Rgb& c) {
  return c[0] + c[1] + c[2];
}

/// sum += rows x light, for unpolarised light.
void add(StokesRgb& sum, const Rgb& rows, const Rgb& light) {
  for (size_t i = 0; i < 3; ++i)
    for (size_t c = 0; c < 3; ++c) sum[i][c] += rows[i] * light[c];
}

/// A walker through one world; it exists for the length of one camera sample.
class Walker {
 public:
  Walker(const World& world, Random& random, PathFaults& faults)
      : world_(world), random_(random), faults_(faults), walk_(world, random) {}

  PathSample run(const CameraRay& camera, const PathParts& parts, const FirstNumbers& first);

 private:
  End follow(Ray& ray, Response<1>& response, double& length, double& weight);
  double phase_share(double phase, double density, const Rgb& beta, double length) const;
  void add_unscattered(Ray ray, Response<3> response, double length, double carried, StokesRgb& sum,
                       StokesRgb& clear);
  void add_scattered(Ray ray, Response<3> response, Rgb beta, const FirstNumbers& first, StokesRgb& sum);
  void add_indirect(Ray ray, const Response<3>& response, const FirstNumbers& first, StokesRgb& sum);
  void connect(const Vec3& position, const Vec3& direction, const Guide::Directions& guided, const Rgb& beta,
               const Rgb& rows, double pick, StokesRgb& sum);

  const World& world_;
  Random& random_;
  PathFaults& faults_;
  Walk walk_;
};

/// Moves the ray, which nothing scatters, until it leaves the scene. `length` gets what lies inside, `weight`
/// the roulette's factor; where the transmittance falls under kDark, roulette follows it.
End Walker::follow(Ray& ray, Response<1>& response, double& length, double& weight) {
  for (int events = 0;; ++events) {
    Hit hit;
    const Meeting meeting = walk_.next(ray, kInfinity, hit);
    if (meeting != Meeting::kSurface) return meeting == Meeting::kLost ? End::kLost : End::kEscaped;
    if (ray.inside) length += hit.distance;
    const double sure = events >= kSureEvents ? kGoOn : 1.0;
    const double go_on = std::min(sure, largest(world_.medium.transmittance(length)) * weight / kDark);
    if (go_on < 1.0) {
      if (!(random_.uniform() < go_on)) return End::kStopped;
      weight /= go_on;
    }
    walk_.cross(hit, ray, response);
  }
}

/// What the phase function's direction counts for, beside the guide's, where both have found light over the
/// same way through the medium: the power heuristic (Veach, "Robust Monte Carlo methods for light transport
/// simulation", 1997, 9.2.4) of how often each would have. The walk has to survive the medium, which a
/// connection has not but for its roulette; both meet the surface alike.
double Walker::phase_share(double phase, double density, const Rgb& beta, double length) const {
  const Rgb transmittance = world_.medium.transmittance(length);
  const double walk = phase * sum(product(beta, transmittance)) / sum(beta);
  const double connection = density * std::min(1.0, largest(transmittance) / kDark);
  if (!(connection > 0.0)) return 1.0;
  const double ratio = walk / connection;
  return ratio < 1.0 ? ratio * ratio / (1.0 + ratio * ratio) : 1.0 / (1.0 + 1.0 / (ratio * ratio));
}

/// The clear dielectric's light, with and without extinction. Both branches of a surface event are followed
/// while each carries at least kSplit of the pixel: left to chance, the faint reflections of the flash on the
/// far side would be the noisiest part of the image.
void Walker::add_unscattered(Ray ray, Response<3> response, double length, double carried, StokesRgb& sum,
                             StokesRgb& clear) {
  double weight = 1.0;
  for (int events = 0;; ++events) {
    Hit hit;
    const Meeting meeting = walk_.next(ray, kInfinity, hit);
    if (meeting == Meeting::kLost) {
      ++faults_.lost;
      return;
    }
    if (meeting == Meeting::kNothing) break;
    if (ray.inside) length += hit.distance;
    if (events >= kSureEvents) {
      if (random_.uniform() >= kGoOn) return;
      weight /= kGoOn;
    }
    const Crossing crossing = walk_.meet(hit, ray);
    const double reflectance = crossing.fresnel.reflectance();
    if (weight > 1.0 || carried * std::min(reflectance, 1.0 - reflectance) < kSplit) {
      walk_.cross(hit, ray, response);
      continue;
    }
    Ray other = ray;
    Response<3> other_response = response;
    walk_.branch(hit, crossing, true, 1.0, other, other_response);
    add_unscattered(other, other_response, length, carried * reflectance, sum, clear);
    walk_.branch(hit, crossing, false, 1.0, ray, response);
    carried *= 1.0 - reflectance;
  }
  const Rgb light = scaled(world_.light->radiance(ray.origin, ray.direction), weight);
  add(clear, first_column(response.pure), light);
  add(sum, first_column(response.pure), product(light, world_.medium.transmittance(length)));
}

/// Light that finds its way to `position` without scattering, along a direction of the guide's.
void Walker::connect(const Vec3& position, const Vec3& direction, const Guide::Directions& guided,
                     const Rgb& beta, const Rgb& rows, double pick, StokesRgb& sum) {
  Ray ray{.origin = position, .direction = guided.sample(pick, random_), .inside = true};
  const double phase = henyey_greenstein(dot(direction, ray.direction), world_.medium.g);
  const double density = guided.density(ray.direction);
  Response<1> response = scalar_response(ray.direction);
  double length = 0.0, weight = 1.0;
  const End end = follow(ray, response, length, weight);
  if (end == End::kLost) ++faults_.lost;
  if (end != End::kEscaped) return;
  const double share = (1.0 - phase_share(phase, density, beta, length)) * phase / density;
  Rgb light = world_.light->radiance(ray.origin, ray.direction);
  light = product(product(light, beta), world_.medium.transmittance(length));
  add(sum, scaled(rows, share * weight * response.pure[0][0]), light);
}

/// Light that has scattered.
void Walker::add_scattered(Ray ray, Response<3> camera, Rgb beta, const FirstNumbers& first, StokesRgb& sum) {
  double length = 0.0;
  End end = walk_.fly(ray, camera, beta, length, &first.flight);
  // Where the light comes out it is unpolarised: one number for each of the pixel's Stokes components.
  const Rgb rows = first_column(camera.scattered);
  for (bool first_scattering = true; end == End::kScattered; first_scattering = false) {
    beta = product(beta, world_.medium.albedo);
    const double throughput = largest(beta);
    if (!(throughput > 0.0)) return;
    if (throughput < kThin) {
      const double go_on = throughput / kThin;
      if (random_.uniform() >= go_on) return;
      beta = scaled(beta, 1.0 / go_on);
    }
    Guide::Directions guided;
    if (world_.guide != nullptr) {
      guided = world_.guide->directions(ray.origin, ray.direction, world_.medium.g);
      const double pick = first_scattering ? first.light : random_.uniform();
      if (guided.known()) connect(ray.origin, ray.direction, guided, beta, rows, pick, sum);
    }

    const double cosine =
        sample_henyey_greenstein(first_scattering ? first.cosine : random_.uniform(), world_.medium.g);
    const double turn = first_scattering ? first.azimuth : random_.uniform();
    const Vec3 direction = around(ray.direction, cosine, 2.0 * std::numbers::pi * turn);
    ray.direction = direction;
    Response<1> response = scalar_response(direction);
    const Rgb before = beta;
    length = 0.0;
    end = walk_.fly(ray, response, beta, length, first_scattering ? &first.second : nullptr);
    if (end == End::kEscaped) {
      const double phase = henyey_greenstein(cosine, world_.medium.g);
      const double share = phase_share(phase, guided.density(direction), before, length);
      const Rgb light = product(world_.light->radiance(ray.origin, ray.direction), beta);
      add(sum, scaled(rows, share * response.pure[0][0]), light);
    }
    beta = scaled(beta, response.scattered[0][0]);
  }
  if (end == End::kLost) ++faults_.lost;
}

/// The same without what scatters before the ray, which is inside, meets the surface. It is sure to get
/// there, and both of what it may do there are followed, if there is something to be found: a ray that leaves
/// may meet the body again.
void Walker::add_indirect(Ray ray, const Response<3>& camera, const FirstNumbers& first, StokesRgb& sum) {
  Hit hit;
  const Meeting meeting = walk_.next(ray, kInfinity, hit);
  if (meeting != Meeting::kSurface) {
    faults_.lost += meeting == Meeting::kLost ? 1 : 0;
    return;
  }
  const Rgb beta = world_.medium.transmittance(hit.distance);
  const Crossing crossing = walk_.meet(hit, ray);
  const double reflectance = crossing.fresnel.reflectance();
  for (const bool reflects : {true, false}) {
    const double carried = largest(beta) * (reflects ? reflectance : 1.0 - reflectance);
    const double go_on = std::min(1.0, carried / kFaint);
    if (!(random_.uniform() < go_on)) continue;
    Ray branch = ray;
    Response<3> response = camera;
    walk_.branch(hit, crossing, reflects, go_on, branch, response);
    if (!reflects && walk_.next(branch, kInfinity, hit) != Meeting::kSurface) continue;
    add_scattered(branch, response, beta, first, sum);
  }
}

PathSample Walker::run(const CameraRay& camera, const PathParts& parts, const FirstNumbers& first) {
  PathSample sample;
  Hit hit;
  const Meeting meeting = world_.geometry->first(camera.origin, camera.direction, hit);
  if (meeting == Meeting::kNothing) {
    sample.background = world_.light->background(camera.direction);
    return sample;
  }
  ++faults_.paths;
  sample.hit = true;
  sample.position = hit.position;
  sample.normal = hit.normal;
  if (meeting == Meeting::kLost) {
    ++faults_.lost;
    return sample;
  }
  const double cosine = -dot(camera.direction, hit.normal);

  const Response<3> rows = camera_response(camera.axis);
  const Fresnel f = fresnel(cosine, world_.index);
  const SurfaceEvent event{
      .direction = camera.direction, .normal = hit.normal, .fresnel = f, .weight = 1.0, .inside = false};

  const bool scatters = parts.scattered && !world_.medium.empty();
  Response<3> mirrored = rows;
  mirrored.reflect(event);
  Ray ray{.origin = {}, .direction = reflect(camera.direction, hit.normal), .inside = false};
  ray.origin = world_.geometry->start(hit, ray.direction, ray.inside);
  Hit ahead;
  if (walk_.next(ray, kInfinity, ahead) == Meeting::kNothing) {
    if (parts.mirror) {
      const Rgb light = world_.light->radiance(ray.origin, ray.direction);
      for (StokesRgb* part : {&sample.mirror, &sample.reflected, &sample.clear}) {
        add(*part, first_column(mirrored.pure), light);
      }
    }
  } else {
    if (parts.unscattered) {
      add_unscattered(ray, mirrored, 0.0, f.reflectance(), sample.reflected, sample.clear);
    }
    if (scatters) add_scattered(ray, mirrored, {1.0, 1.0, 1.0}, first, sample.scattered);
  }

  if (f.reflectance() < 1.0 && (parts.unscattered || scatters)) {
    Response<3> refracted = rows;
    refracted.transmit(event);
    ray = {.origin = {}, .direction = refract(camera.direction, hit.normal, f, world_.index), .inside = true};
    ray.origin = world_.geometry->start(hit, ray.direction, ray.inside);
    if (parts.unscattered) {
      add_unscattered(ray, refracted, 0.0, 1.0 - f.reflectance(), sample.unscattered, sample.clear);
    }
    if (scatters && parts.direct) add_scattered(ray, refracted, {1.0, 1.0, 1.0}, first, sample.scattered);
    if (scatters && !parts.direct) add_indirect(ray, refracted, first, sample.scattered);
  }
  return sample;
}

}  // namespace

PathSample sample_path(const World& world, const CameraRay& ray, Random& random, PathFaults& faults) {
  return Walker(world, random, faults).run(ray, {}, FirstNumbers(random));
}

PathSample sample_path_parts(const World& world, const CameraRay& ray, const PathParts& parts,
                             const FirstNumbers& first, Random& random, PathFaults& faults) {
  return Walker(world, random, faults).run(ray, parts, first);
}

}  // namespace opaline::render
