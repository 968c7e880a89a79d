#include "data/render/camera.h"

#include <cmath>
#include <numbers>

namespace opaline::render {
namespace {

constexpr double kPi = std::numbers::pi;

}  // namespace

CameraRay Camera::ray(double x, double y) const {
  const double half = std::tan(0.5 * field * kPi / 180.0);
  const double scale = 2.0 * half / width;
  const Vec3 direction = normalised({(x - 0.5 * width) * scale, (0.5 * height - y) * scale, -1.0});
  // The image's x axis, projected perpendicular to the ray.
  const Vec3 axis = normalised(Vec3{1.0, 0.0, 0.0} - direction * direction.x);
  return {position, direction, axis};
}

double Camera::pixel_size(double z) const {
  return 2.0 * std::tan(0.5 * field * kPi / 180.0) * (position.z - z) / width;
}

}  // namespace opaline::render
