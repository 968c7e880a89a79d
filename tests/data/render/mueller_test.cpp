#include "data/render/mueller.h"

#include <catch2/catch.hpp>
#include <cmath>
#include <numbers>

using namespace opaline::render;

namespace {

Stokes row_times(const Stokes& row, const Mueller& m) {
  Stokes result{};
  for (size_t j = 0; j < 4; ++j)
    for (size_t i = 0; i < 4; ++i) result[j] += row[i] * m[i][j];
  return result;
}

}  // namespace

TEST_CASE("a frame turned by 45 degrees exchanges S1 and S2") {
  const Stokes turned = apply(frame_rotation(std::numbers::pi / 4), {1.0, 0.5, 0.25, 0.1});
  CHECK(turned[0] == Approx(1.0));
  CHECK(turned[1] == Approx(0.25));
  CHECK(turned[2] == Approx(-0.5));
  CHECK(turned[3] == Approx(0.1));
}

TEST_CASE("an event multiplies rows by rotation and matrix") {
  // A camera above looks down at a surface whose plane of incidence is turned by `turn` from its axis.
  const Vec3 direction = normalised({0.4, 0.2, -0.9});
  const Vec3 normal{0.0, 0.0, 1.0};
  const Fresnel f = fresnel(-dot(direction, normal), kRefractiveIndex);
  const Vec3 s = normalised(cross(normal, direction));
  const Vec3 k = -direction;
  for (const double turn : {0.0, 0.3, 1.2, 2.9}) {
    // The axis X such that s = X turned by `turn` towards Y = k x X.
    const Vec3 axis = s * std::cos(turn) - cross(k, s) * std::sin(turn);
    Response<3> reflected = camera_response(axis), refracted = camera_response(axis);
    const SurfaceEvent event{
        .direction = direction, .normal = normal, .fresnel = f, .weight = 2.0, .inside = false};
    reflected.reflect(event);
    refracted.transmit(event);
    for (size_t i = 0; i < 3; ++i) {
      Stokes row{};
      row[i] = 1.0;
      // Light: event's frame -> pixel's frame, hence a turn by -turn after the matrix.
      const Mueller to_pixel = frame_rotation(-turn);
      const Stokes expect_r = row_times(row, product(to_pixel, reflection(f)));
      const Stokes expect_t = row_times(row, product(to_pixel, transmission(f)));
      const Stokes expect_d = row_times(row, product(product(to_pixel, transmission(f)), depolariser()));
      for (size_t j = 0; j < 4; ++j) {
        CHECK(reflected.pure[i][j] == Approx(2.0 * expect_r[j]).margin(1e-12));
        CHECK(refracted.pure[i][j] == Approx(2.0 * expect_t[j]).margin(1e-12));
        CHECK(refracted.scattered[i][j] == Approx(2.0 * expect_d[j]).margin(1e-12));
      }
    }
  }
}

TEST_CASE("normal incidence keeps the frame") {
  const Vec3 axis{1.0, 0.0, 0.0};
  Response<3> r = camera_response(axis);
  r.transmit({.direction = {0, 0, -1},
              .normal = {0, 0, 1},
              .fresnel = fresnel(1.0, kRefractiveIndex),
              .weight = 1.0,
              .inside = false});
  CHECK(dot(r.axis, axis) == Approx(1.0));
  for (const Stokes& row : r.pure)
    for (const double value : row) CHECK(std::isfinite(value));
}

TEST_CASE("reflection leaves fully polarised light fully polarised") {
  for (const double cosine : {0.9, 0.55, 0.2}) {
    for (const double eta : {kRefractiveIndex, 1.0 / kRefractiveIndex}) {
      const Mueller m = reflection(fresnel(cosine, eta));
      const Stokes out = apply(m, {1.0, 0.6, 0.64, 0.48});
      CHECK(out[1] * out[1] + out[2] * out[2] + out[3] * out[3] == Approx(out[0] * out[0]).margin(1e-12));
    }
  }
}
