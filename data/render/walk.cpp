#include "data/render/walk.h"

#include <cmath>

namespace opaline::render {
namespace {

/// One flight in so many looks for the surface beyond its end, to see that it is still inside.
constexpr int kSureFlights = 64;

}  // namespace

Crossing Walk::meet(const Hit& hit, const Ray& ray) const {
  const double eta = ray.inside ? 1.0 / world_.index : world_.index;
  return {fresnel(std::abs(dot(ray.direction, hit.normal)), eta), eta};
}

template <int R>
void Walk::branch(const Hit& hit, const Crossing& crossing, bool reflects, double probability, Ray& ray,
                  Response<R>& response) const {
  const SurfaceEvent event{.direction = ray.direction,
                           .normal = hit.normal,
                           .fresnel = crossing.fresnel,
                           .weight = 1.0 / probability,
                           .inside = ray.inside};
  if (reflects) {
    response.reflect(event);
    ray.direction = reflect(ray.direction, hit.normal);
  } else {
    response.transmit(event);
    const Vec3 facing = dot(ray.direction, hit.normal) < 0.0 ? hit.normal : -hit.normal;
    ray.direction = refract(ray.direction, facing, crossing.fresnel, crossing.eta);
    ray.inside = !ray.inside;
  }
  ray.origin = world_.geometry->start(hit, ray.direction, ray.inside);
  ray.flights = 0;
}

template <int R>
void Walk::cross(const Hit& hit, Ray& ray, Response<R>& response) {
  const Crossing crossing = meet(hit, ray);
  const double reflectance = crossing.fresnel.reflectance();
  const bool reflects = crossing.fresnel.total || random_.uniform() < reflectance;
  branch(hit, crossing, reflects, reflects ? reflectance : 1.0 - reflectance, ray, response);
}

template <int R>
End Walk::fly(Ray& ray, Response<R>& response, Rgb& beta, double& length, const FlightNumbers* first) {
  for (int events = 0;; ++events) {
    Hit hit;
    if (ray.inside) {
      const SpectralFlight flight(world_.medium, beta);
      const double choose = first != nullptr ? first->channel : random_.uniform();
      const double distance = flight.sample(choose, first != nullptr ? first->distance : random_.uniform());
      first = nullptr;
      // Without a margin nothing is rounded, and a half-space has no far side to be seen.
      const double margin = world_.geometry->margin();
      const bool sure = margin > 0.0 && ray.flights++ % kSureFlights == 0;
      const bool unbounded = sure || !world_.bounded_queries;
      const Meeting meeting = next(ray, unbounded ? kInfinity : distance + margin, hit);
      if (meeting == Meeting::kLost) return End::kLost;
      if (meeting == Meeting::kNothing || hit.distance > distance) {
        if (!std::isfinite(distance)) return End::kLost;
        flight.collide(distance, beta);
        ray.origin = ray.origin + ray.direction * distance;
        if (meeting == Meeting::kSurface) ray.origin = world_.geometry->keep_inside(ray.origin, hit);
        return End::kScattered;
      }
      flight.arrive(hit.distance, beta);
      length += hit.distance;
    } else if (const Meeting meeting = next(ray, kInfinity, hit); meeting != Meeting::kSurface) {
      return meeting == Meeting::kLost ? End::kLost : End::kEscaped;
    }
    if (events >= kSureEvents) {
      if (random_.uniform() >= kGoOn) return End::kStopped;
      beta = scaled(beta, 1.0 / kGoOn);
    }
    cross(hit, ray, response);
  }
}

template void Walk::branch(const Hit&, const Crossing&, bool, double, Ray&, Response<1>&) const;
template void Walk::branch(const Hit&, const Crossing&, bool, double, Ray&, Response<3>&) const;
template void Walk::cross(const Hit&, Ray&, Response<1>&);
template void Walk::cross(const Hit&, Ray&, Response<3>&);
template End Walk::fly(Ray&, Response<1>&, Rgb&, double&, const FlightNumbers*);
template End Walk::fly(Ray&, Response<3>&, Rgb&, double&, const FlightNumbers*);

Vec3 reflect(const Vec3& direction, const Vec3& normal) {
  return normalised(direction - normal * (2.0 * dot(direction, normal)));
}

Vec3 refract(const Vec3& direction, const Vec3& normal, const Fresnel& f, double eta) {
  const double cosine = -dot(direction, normal);
  return normalised(direction * (1.0 / eta) + normal * (cosine / eta - f.cos_transmit));
}

}  // namespace opaline::render
