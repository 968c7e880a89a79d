#include "data/render/emitter.h"

#include <cmath>
#include <numbers>

namespace opaline::render {
namespace {

constexpr double kPi = std::numbers::pi;
/// Sine of the steepest angle to the axis at which flash and ball may see each other.
constexpr double kSteepest = 0.95;

Vec3 disc(const Vec3& axis, double radius, double u, double v) {
  const Basis basis = basis_around(axis);
  const double r = radius * std::sqrt(u), angle = 2.0 * kPi * v;
  return basis.first * (r * std::cos(angle)) + basis.second * (r * std::sin(angle));
}

}  // namespace

Emitter::Emitter(const Illumination& light, const Vec3& centre, double radius)
    : light_(light), centre_(centre), radius_(radius) {
  const bool flashes = light.flash.radiance > 0.0;
  const double flash = flashes ? light.flash.irradiance(centre) : 0.0;
  const double environment = mean(light.environment.fluence());
  dark_ = !(flash + environment > 0.0);
  flash_share_ = dark_ ? 0.0 : flash / (flash + environment);
  if (!flashes) return;
  // A line that meets both balls is at most so steep, and crosses the planes through their centres at most so
  // much farther out.
  const double sine = (light.flash.radius + radius) / norm(light.flash.centre - centre);
  complete_ = sine < kSteepest;
  flash_widening_ = 1.0 / std::sqrt(1.0 - std::fmin(sine, kSteepest) * std::fmin(sine, kSteepest));
}

LightRay Emitter::emit(std::span<const double, kDimensions> u) const {
  if (u[0] < flash_share_) {
    const Flash& flash = light_.flash;
    const Vec3 between = flash.centre - centre_, axis = normalised(between);
    const double wide = flash_widening_ * flash.radius, aim = flash_widening_ * radius_;
    const Vec3 from = flash.centre + disc(axis, wide, u[1], u[2]);
    const Vec3 to = centre_ + disc(axis, aim, u[3], u[4]), way = to - from;
    const double distance = norm(way);
    LightRay ray{from, way * (1.0 / distance), {}};
    // From beside the flash rather than from within: what lies between is nobody's.
    if (!flash.hit(to, -ray.direction)) return ray;
    const double cosine = -dot(ray.direction, axis);
    const double areas = kPi * wide * wide * kPi * aim * aim;
    const double flux = flash.radiance * areas * cosine * cosine / (distance * distance) / flash_share_;
    ray.flux = {flux, flux, flux};
    return ray;
  }
  const double pick = (u[0] - flash_share_) / (1.0 - flash_share_);
  const Vec3 towards = light_.environment.sample(pick, u[1], u[2]);
  const Vec3 aim = centre_ + disc(towards, radius_, u[3], u[4]);
  LightRay ray{aim + towards * (2.0 * radius_), -towards, {}};
  // The flash stands before what is behind it.
  const double density = light_.environment.density(towards);
  if (!(density > 0.0) || (light_.flash.radiance > 0.0 && light_.flash.hit(aim, towards))) return ray;
  ray.flux = scaled(light_.environment.radiance(towards),
                    kPi * radius_ * radius_ / (density * (1.0 - flash_share_)));
  return ray;
}

}  // namespace opaline::render
