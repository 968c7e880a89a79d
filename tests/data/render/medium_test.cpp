#include "data/render/medium.h"

#include <catch2/catch.hpp>
#include <cmath>
#include <numbers>

#include "core/random.h"

using namespace opaline;
using namespace opaline::render;

TEST_CASE("Henyey-Greenstein has mean cosine g and second Legendre moment g^2") {
  for (const double g : {0.0, 1e-4, 0.5, 0.9, 0.99, -0.7}) {
    // Stratified, so that the error is far below the tolerance.
    constexpr int kCount = 200'000;
    double first = 0.0, second = 0.0;
    for (int i = 0; i < kCount; ++i) {
      const double c = sample_henyey_greenstein((i + 0.5) / kCount, g);
      REQUIRE((c >= -1.0 && c <= 1.0));
      first += c;
      second += 1.5 * c * c - 0.5;
    }
    CHECK(first / kCount == Approx(g).margin(1e-6));
    CHECK(second / kCount == Approx(g * g).margin(1e-6));
  }
}

TEST_CASE("Henyey-Greenstein integrates to one") {
  for (const double g : {0.0, 0.5, 0.9, -0.7}) {
    double sum = 0.0;
    constexpr int kCount = 200'000;
    for (int i = 0; i < kCount; ++i) {
      const double cosine = -1.0 + 2.0 * (i + 0.5) / kCount;
      sum += henyey_greenstein(cosine, g) * 2.0 * std::numbers::pi * 2.0 / kCount;
    }
    CHECK(sum == Approx(1.0).margin(1e-5));
  }
}

TEST_CASE("one flight serves three colours without bias") {
  const Medium medium{.sigma_t = {0.5, 3.0, 20.0}, .albedo = {1.0, 1.0, 1.0}, .g = 0.0};
  constexpr double kDistance = 0.3;
  constexpr int kCount = 400'000;
  Random random(3, Purpose::kTest);
  Rgb arrived{}, collided{};
  for (int i = 0; i < kCount; ++i) {
    Rgb beta{1.0, 0.5, 2.0};
    const SpectralFlight flight(medium, beta);
    const double choose = random.uniform();
    const double distance = flight.sample(choose, random.uniform());
    const double before = beta[0] + beta[1] + beta[2];
    if (distance < kDistance) {
      flight.collide(distance, beta);
      for (size_t c = 0; c < 3; ++c) collided[c] += beta[c];
    } else {
      flight.arrive(kDistance, beta);
      for (size_t c = 0; c < 3; ++c) arrived[c] += beta[c];
    }
    REQUIRE(beta[0] + beta[1] + beta[2] == Approx(before));
  }
  const Rgb start{1.0, 0.5, 2.0};
  const Rgb transmittance = medium.transmittance(kDistance);
  for (size_t c = 0; c < 3; ++c) {
    CHECK(arrived[c] / kCount == Approx(start[c] * transmittance[c]).margin(0.01));
    CHECK(collided[c] / kCount == Approx(start[c] * (1.0 - transmittance[c])).margin(0.01));
  }
}

TEST_CASE("a colour without a medium flies for ever") {
  const Medium medium{.sigma_t = {0.0, 1.0, 1.0}, .albedo = {}, .g = 0.0};
  CHECK(std::isinf(SpectralFlight(medium, {1.0, 0.0, 0.0}).sample(0.5, 0.5)));
  CHECK(Medium{}.empty());
}
