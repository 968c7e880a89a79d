#include "data/render/fresnel.h"

#include <catch2/catch.hpp>
#include <cmath>
#include <numbers>

using namespace opaline::render;

TEST_CASE("an interface neither makes nor loses light, from either side") {
  for (const double eta : {1.5046, 1.0 / 1.5046, 1.0, 2.5}) {
    for (int i = 0; i <= 1000; ++i) {
      const Fresnel f = fresnel(i / 1000.0, eta);
      REQUIRE((f.reflect_s >= 0.0 && f.reflect_s <= 1.0));
      REQUIRE((f.reflect_p >= 0.0 && f.reflect_p <= 1.0));
      // |r_s conj(r_p)|^2 = R_s R_p.
      REQUIRE(f.cross_real * f.cross_real + f.cross_imag * f.cross_imag ==
              Approx(f.reflect_s * f.reflect_p).margin(1e-14));
    }
  }
}

TEST_CASE("both directions through an interface reflect alike") {
  for (const double angle : {0.0, 0.3, 0.9, 1.4}) {
    const Fresnel in = fresnel(std::cos(angle), kRefractiveIndex);
    const Fresnel out = fresnel(in.cos_transmit, 1.0 / kRefractiveIndex);
    CHECK(out.reflect_s == Approx(in.reflect_s).epsilon(1e-12));
    CHECK(out.reflect_p == Approx(in.reflect_p).margin(1e-14));
    CHECK(out.cos_transmit == Approx(std::cos(angle)).epsilon(1e-12));
  }
}

TEST_CASE("total reflection retards as Born and Wolf's (1.5.4.46) says") {
  const double n = kRefractiveIndex;
  for (const double degrees : {42.0, 45.0, 55.0, 70.0, 89.0}) {
    const double angle = degrees * std::numbers::pi / 180.0;
    const Fresnel f = fresnel(std::cos(angle), 1.0 / n);
    REQUIRE(f.total);
    const double s = std::sin(angle);
    const double expected = 2.0 * std::atan(std::cos(angle) * std::sqrt(s * s - 1.0 / (n * n)) / (s * s));
    const double delta = std::abs(std::atan2(f.cross_imag, f.cross_real));
    // The frames of the reflected ray turn p over, which adds pi.
    CHECK(std::min(delta, std::numbers::pi - delta) ==
          Approx(std::min(expected, std::numbers::pi - expected)).epsilon(1e-9));
  }
}

TEST_CASE("grazing and normal incidence are defined") {
  CHECK(fresnel(0.0, kRefractiveIndex).reflectance() == Approx(1.0).margin(1e-9));
  CHECK(fresnel(1.0, kRefractiveIndex).reflectance() == Approx(0.040590).margin(5e-7));
  CHECK(fresnel(0.0, 1.0).reflectance() == Approx(0.0).margin(1e-9));
  CHECK(std::isfinite(fresnel(std::cos(89.999 * std::numbers::pi / 180), 1 / kRefractiveIndex).cross_imag));
}

TEST_CASE("average reflectances") {
  CHECK(diffuse_reflectance(kRefractiveIndex) == Approx(0.092453).margin(5e-7));
  CHECK(diffuse_reflectance(1.0 / kRefractiveIndex) == Approx(0.599108).margin(5e-7));
}
