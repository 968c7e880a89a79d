#include "data/render/light.h"

#include <catch2/catch.hpp>
#include <cmath>
#include <numbers>

#include "core/error.h"
#include "data/render/room.h"

using namespace opaline;
using namespace opaline::render;

namespace {

/// An environment whose texels are f(direction).
template <class F>
Environment environment_of(const F& f, int64_t height = 256) {
  std::vector<Rgb> texels;
  for (int64_t i = 0; i < height; ++i) {
    for (int64_t j = 0; j < 2 * height; ++j) {
      const double latitude = (static_cast<double>(i) + 0.5) / static_cast<double>(height) * std::numbers::pi;
      const double longitude =
          ((static_cast<double>(j) + 0.5) / static_cast<double>(2 * height) - 0.5) * 2.0 * std::numbers::pi;
      const double s = std::sin(latitude);
      texels.push_back(f(Vec3{s * std::sin(longitude), std::cos(latitude), -s * std::cos(longitude)}));
    }
  }
  return {std::move(texels), 2 * height};
}

Rgb grey(double v) {
  return {v, v, v};
}

}  // namespace

TEST_CASE("spherical harmonics of known lights") {
  const auto constant = Environment(grey(1.0)).project();
  CHECK(constant[0][0] == Approx(3.54491).margin(1e-4));
  for (size_t k = 1; k < 9; ++k) CHECK(constant[1][k] == Approx(0.0).margin(1e-4));

  const auto lobe = environment_of([](const Vec3& d) { return grey(std::max(0.0, d.z)); }).project();
  CHECK(lobe[2][0] == Approx(.88623).margin(1e-3));
  CHECK(lobe[2][2] == Approx(1.02333).margin(1e-3));
  CHECK(lobe[2][6] == Approx(.49542).margin(1e-3));
  for (const size_t k : {1U, 3U, 4U, 5U, 7U, 8U}) CHECK(lobe[0][k] == Approx(0.0).margin(1e-3));
}

TEST_CASE("rotation keeps the norm of each band") {
  const Vec3 axis = normalised({0.3, -0.8, 0.5});
  const auto lobe =
      environment_of([&](const Vec3& d) { return grey(std::max(0.0, dot(d, axis))); }).project()[0];
  const auto band = [&](size_t begin, size_t end) {
    double sum = 0.0;
    for (size_t k = begin; k < end; ++k) sum += lobe[k] * lobe[k];
    return std::sqrt(sum);
  };
  CHECK(band(0, 1) == Approx(.88623).margin(1e-3));
  CHECK(band(1, 4) == Approx(1.02333).margin(1e-3));
  CHECK(band(4, 9) == Approx(.49542).margin(1e-3));
  // Band 1 is (y, z, x) and points to the light.
  CHECK(lobe[1] / band(1, 4) == Approx(axis.y).margin(1e-3));
  CHECK(lobe[2] / band(1, 4) == Approx(axis.z).margin(1e-3));
  CHECK(lobe[3] / band(1, 4) == Approx(axis.x).margin(1e-3));
}

TEST_CASE("a direction finds the texel that was made for it") {
  const Environment e = environment_of([](const Vec3& d) { return Rgb{1 + d.x, 1 + d.y, 1 + d.z}; });
  Random random(1, Purpose::kTest);
  for (int i = 0; i < 1000; ++i) {
    const Vec3 d = around({0, 0, 1}, random.uniform(-0.99, 0.99), random.uniform(0, 6.28));
    const Rgb light = e.radiance(d);
    REQUIRE(light[0] == Approx(1 + d.x).margin(1e-3));
    REQUIRE(light[1] == Approx(1 + d.y).margin(1e-3));
    REQUIRE(light[2] == Approx(1 + d.z).margin(1e-3));
  }
}

TEST_CASE("directions are drawn in proportion to brightness") {
  const Environment e = environment_of([](const Vec3& d) { return grey(d.y > 0.0 ? 3.0 : 1.0); }, 64);
  Random random(4, Purpose::kTest);
  int up = 0;
  constexpr int kCount = 100'000;
  for (int i = 0; i < kCount; ++i) {
    const Vec3 d = e.sample(random.uniform(), random.uniform(), random.uniform());
    REQUIRE(norm(d) == Approx(1.0));
    if (d.y > 0.0) ++up;
  }
  CHECK(up == Approx(0.75 * kCount).margin(4 * std::sqrt(kCount * 0.1875)));
}

TEST_CASE("the density of drawn directions is what it says, beside dark texels too", "[statistics]") {
  std::vector<Rgb> texels(6 * 12, Rgb{});
  texels[2 * 12 + 11] = {9.0, 0.0, 0.0};  // next to the seam
  texels[4] = {1.0, 1.0, 1.0};            // at the pole
  const Environment e(texels, 12);
  Random random(5, Purpose::kTest);
  constexpr int kCount = 400'000;
  // The density is that of the draws: over every half-space both give the same share.
  for (const Vec3& n : {Vec3{0, 0, 1}, Vec3{1, 0, 0}, Vec3{0, 1, 0}}) {
    double drawn = 0.0, said = 0.0, square = 0.0, light = 0.0;
    for (int i = 0; i < kCount; ++i) {
      const Vec3 d = e.sample(random.uniform(), random.uniform(), random.uniform());
      REQUIRE(e.density(d) > 0.0);
      if (dot(d, n) > 0.0) drawn += 1.0;
      light += e.radiance(d)[0] / e.density(d);
      const Vec3 even = around({0, 0, 1}, random.uniform(-1, 1), random.uniform(0, 2 * std::numbers::pi));
      const double p = dot(even, n) > 0.0 ? 4.0 * std::numbers::pi * e.density(even) : 0.0;
      said += p;
      square += p * p;
      if (e.radiance(even)[0] > 0.0) REQUIRE(e.density(even) > 0.0);
    }
    const double share = said / kCount, error = std::sqrt((square / kCount - share * share) / kCount);
    CHECK(std::abs(drawn / kCount - share) <= 4.0 * error + 4.0 * 0.5 / std::sqrt(kCount));
    CHECK(light / kCount == Approx(e.fluence()[0]).epsilon(0.01));
  }
}

TEST_CASE("irradiance and fluence of uniform light") {
  const Environment e(grey(2.0));
  CHECK(e.irradiance({0, 0, 1})[1] == Approx(2.0 * std::numbers::pi).epsilon(1e-4));
  CHECK(e.fluence()[1] == Approx(8.0 * std::numbers::pi).epsilon(1e-6));
}

TEST_CASE("the flash gives pi L (r / d)^2") {
  Illumination light;
  light.flash.radiance = 50.0;
  CHECK(light.flash.irradiance({}) == Approx(2.454).margin(5e-4));
  // The same by looking: cosine-weighted directions within the cone that holds the sphere.
  Random random(6, Purpose::kTest);
  constexpr int kCount = 200'000;
  const double sin2 = 0.02;  // the sphere's is (0.1 / 0.8)^2
  double sum = 0.0;
  for (int i = 0; i < kCount; ++i) {
    const double cosine = std::sqrt(1.0 - sin2 * random.uniform());
    sum += light.radiance({}, around({0, 0, 1}, cosine, random.uniform(0, 6.2831853)))[0];
  }
  CHECK(sum / kCount * std::numbers::pi * sin2 == Approx(2.4544).epsilon(0.005));
  CHECK(light.background({0, 0, 1})[0] == 0.0);
}

TEST_CASE("turning an environment turns its light around the vertical axis") {
  std::vector<Rgb> texels(8 * 16, Rgb{1.0, 1.0, 1.0});
  texels[3 * 16 + 8] = {100.0, 100.0, 100.0};  // towards -z
  Environment environment(texels, 16);
  CHECK(environment.irradiance({0, 0, -1})[0] > environment.irradiance({1, 0, 0})[0]);
  const Rgb before = environment.fluence();
  environment.turn(0.25);
  CHECK(environment.irradiance({-1, 0, 0})[0] > environment.irradiance({0, 0, -1})[0]);
  CHECK(environment.fluence()[0] == Approx(before[0]).epsilon(1e-9));
  Random random(1, Purpose::kTest);
  int towards = 0;
  for (int i = 0; i < 1000; ++i)
    towards += environment.sample(random.uniform(), random.uniform(), random.uniform()).x < 0.0 ? 1 : 0;
  CHECK(towards > 700);
}

TEST_CASE("a radiance that is no light is refused") {
  CHECK_THROWS_AS(Environment({Rgb{1.0, std::nan(""), 1.0}}, 1), Error);
  CHECK_THROWS_AS(Environment({Rgb{1.0, -1.0, 1.0}}, 1), Error);
  CHECK_THROWS_AS(Environment({Rgb{}, Rgb{}, Rgb{}}, 2), Error);
}
