#include "data/render/figures.h"

#include <array>
#include <catch2/catch.hpp>
#include <cmath>
#include <numbers>

#include "core/error.h"
#include "data/render/moments.h"
#include "tests/data/render/adding.h"

using namespace opaline;
using namespace opaline::render;

namespace {

constexpr double kLargestError = 0.003;

/// Within three standard errors, which are at most 0.3 % of the figure, or 1e-4 for zeros; false on NaN.
void check_figures(const std::vector<Figure>& figures) {
  for (const Figure& f : figures) {
    INFO(f.name << " " << f.value << " +- " << f.standard_error << " expected " << f.expected);
    CHECK(f.passes());
    CHECK(f.standard_error <= std::max(1e-4, kLargestError * std::abs(f.expected)));
    CHECK(f.tolerance <= std::max(1e-4, kLargestError * std::abs(f.expected)));
  }
}

void check_estimate(const char* what, const Estimate& e, double expected) {
  INFO(what << " " << e.mean << " +- " << e.standard_error << " expected " << expected);
  CHECK(e.standard_error <= std::max(1e-4, kLargestError * expected));
  CHECK(std::abs(e.mean - expected) <= 3.0 * e.standard_error + 1e-9);
}

/// Radiance 1 in each colour from one ring of directions, by their cosine with the half-space's normal.
constexpr std::array<double, 4> kRings = {0.0, 0.4, 0.8, 1.0};
class Rings final : public Light {
 public:
  Rgb radiance(const Vec3&, const Vec3& d) const override {
    return {d.z < kRings[1] ? 1.0 : 0.0, d.z >= kRings[1] && d.z < kRings[2] ? 1.0 : 0.0,
            d.z >= kRings[2] ? 1.0 : 0.0};
  }
  Rgb background(const Vec3& d) const override { return radiance({}, d); }
};

}  // namespace

TEST_CASE("a figure that is not a number does not pass") {
  const double nan = std::nan("");
  CHECK_FALSE(Figure{"", nan, 0.1, 1.0, 0.0}.passes());
  CHECK_FALSE(Figure{"", 1.5, nan, 1.0, 0.1}.passes());
  CHECK_FALSE(Figure{"", nan, 0.0, 1.0, 0.1}.passes());
  CHECK_FALSE(Figure{"", nan, nan, nan, nan}.passes());
  CHECK(Figure{"", 1.05, 0.0, 1.0, 0.1}.passes());
}

TEST_CASE("moments of the phase function, several seeds") {
  for (const uint64_t seed : {1U, 2U, 3U})
    for (const double g : {0.0, 1e-4, 0.5, 0.75, 0.9, 0.99, -0.7, -0.99})
      check_figures(validate_hg(g, 200'000, seed));
  CHECK_THROWS_AS(validate_hg(1.0), UsageError);
  CHECK_THROWS_AS(validate_hg(std::nan("")), UsageError);
  CHECK_THROWS_AS(validate_hg(0.5, 10), UsageError);
}

TEST_CASE("spherical harmonics of known lights, turned ones too", "[statistics]") {
  check_figures(validate_sh(2, 1));
}

TEST_CASE("the flash's irradiance by formula, by looking and by path tracing", "[statistics]") {
  for (const uint64_t seed : {1U, 2U, 3U}) check_figures(validate_flash(8'000'000, seed));
}

TEST_CASE("Chandrasekhar's H function") {
  const ChandrasekharH h(0.9);
  CHECK(h(1.0) == Approx(1.85010).margin(1e-5));
  CHECK(h(0.0) == Approx(1.0).margin(1e-3));
  CHECK(ChandrasekharH(0.0)(0.5) == 1.0);
  // The albedo for normal incidence is 1 - H(1) sqrt(1 - a).
  CHECK(1.0 - h(1.0) * std::sqrt(0.1) == Approx(.41495).margin(1e-5));
  CHECK(1.0 - ChandrasekharH(0.5)(1.0) * std::sqrt(0.5) == Approx(.11523).margin(1e-5));
  CHECK(1.0 - ChandrasekharH(0.99)(1.0) * std::sqrt(0.01) == Approx(.75272).margin(1e-5));
  CHECK_THROWS_AS(ChandrasekharH(1.0), UsageError);
}

TEST_CASE("a half-space's BRDF is Chandrasekhar's", "[statistics]") {
  const ChandrasekharH h(0.9);
  const auto half_space = make_slab_geometry(kInfinity);
  const Rings light;
  const World world{.geometry = half_space.get(),
                    .light = &light,
                    .medium = {.sigma_t = {1, 1, 1}, .albedo = {0.9, 0.9, 0.9}, .g = 0.0},
                    .index = 1.0};
  for (const double view : {1.0, 0.5}) {
    const Vec3 d{std::sqrt(1.0 - view * view), 0.0, -view};
    const auto seen =
        run_blocks<Moments<3>>(1'200'000, 1, [&](Random& random, Moments<3>& part, int64_t paths) {
          PathFaults faults;
          for (int64_t i = 0; i < paths; ++i) {
            part.add(sample_path(world, {-d, d, {0, 1, 0}}, random, faults).scattered[0]);
          }
        });
    for (size_t ring = 0; ring < 3; ++ring) {
      const double low = kRings[ring], width = kRings[ring + 1] - low;
      double expected = 0.0;
      constexpr int kSteps = 400;
      for (int i = 0; i < kSteps; ++i) {
        const double c = low + width * (i + 0.5) / kSteps;
        expected += h.brdf(c, view) * c * 2.0 * std::numbers::pi * width / kSteps;
      }
      INFO("seen at cosine " << view << ", lit from " << low << " to " << low + width);
      check_estimate("radiance", seen.estimate(ring), expected);
    }
  }
}

TEST_CASE("slabs reflect and transmit what the literature says, several seeds", "[statistics]") {
  for (const uint64_t seed : {11U, 12U}) {
    const auto run = [seed](double albedo, double g, double tau, double index, bool lambertian,
                            int64_t paths) {
      return validate_slab({.albedo = albedo,
                            .g = g,
                            .tau = tau,
                            .index = index,
                            .lambertian = lambertian,
                            .paths = paths,
                            .seed = seed});
    };
    const SlabResult layer = run(0.9, 0.75, 2.0, 1.0, false, 1'200'000);
    check_estimate("van de Hulst, Rd", layer.reflected, 0.09739);
    check_estimate("van de Hulst, T", layer.transmitted, 0.66096);
    check_estimate("Giovanelli", run(0.9, 0.0, kInfinity, 1.5, false, 400'000).reflected, 0.2200);
    check_estimate(".5, normal", run(0.5, 0.0, kInfinity, 1.0, false, 900'000).reflected, .11523);
    check_estimate(".5, diffuse", run(0.5, 0.0, kInfinity, 1.0, true, 700'000).reflected, .14654);
    check_estimate(".9, normal", run(0.9, 0.0, kInfinity, 1.0, false, 200'000).reflected, .41495);
    check_estimate(".9, diffuse", run(0.9, 0.0, kInfinity, 1.0, true, 200'000).reflected, .47802);
    check_estimate(".99, normal", run(0.99, 0.0, kInfinity, 1.0, false, 60'000).reflected, .75272);
    check_estimate(".99, diffuse", run(0.99, 0.0, kInfinity, 1.0, true, 60'000).reflected, .79456);
  }
}

TEST_CASE("adding-doubling gives the literature's figures") {
  const AddingDoubling layer(0.9, 0.75, 2.0, 24), deep(0.99, 0.0, 1000.0, 16);
  CHECK(layer.normal().reflected == Approx(0.09739).margin(1e-5));
  CHECK(layer.normal().transmitted == Approx(0.66096).margin(1e-5));
  CHECK(deep.normal().reflected == Approx(.75272).margin(1e-5));
  CHECK(deep.diffuse().reflected == Approx(.79456).margin(1e-5));
}

TEST_CASE("slabs agree with adding-doubling", "[statistics]") {
  struct Layer {
    double albedo, g, tau;
    int64_t paths;
  };
  for (const Layer& l : {Layer{1.0, 0.0, 1.0, 250'000}, Layer{0.95, -0.5, 4.0, 1'200'000},
                         Layer{0.9, 1e-4, 0.5, 900'000}, Layer{0.99, 0.9, 12.0, 400'000}}) {
    const AddingDoubling exact(l.albedo, l.g, l.tau, 32);
    for (const bool lambertian : {false, true}) {
      INFO("albedo " << l.albedo << " g " << l.g << " tau " << l.tau
                     << (lambertian ? " diffuse" : " normal"));
      const SlabResult r = validate_slab({.albedo = l.albedo,
                                          .g = l.g,
                                          .tau = l.tau,
                                          .lambertian = lambertian,
                                          .paths = l.paths,
                                          .seed = 5});
      const LayerFluxes fluxes = lambertian ? exact.diffuse() : exact.normal();
      check_estimate("Rd", r.reflected, fluxes.reflected);
      check_estimate("T", r.transmitted, fluxes.transmitted);
    }
  }
}

TEST_CASE("what is not absorbed comes out of a slab, with an interface too", "[statistics]") {
  for (const double g : {0.0, 0.9, -0.9}) {
    for (const double tau : {1e-4, 0.3, 20.0}) {
      for (const double index : {1.0, 1.5046}) {
        const SlabResult r = validate_slab({.albedo = 1.0,
                                            .g = g,
                                            .tau = tau,
                                            .index = index,
                                            .lambertian = true,
                                            .paths = tau < 0.01 ? 1'000'000 : 20'000,  // few scatter
                                            .seed = 1});
        const double error = std::hypot(r.reflected.standard_error, r.transmitted.standard_error);
        INFO("g " << g << " tau " << tau << " n " << index);
        CHECK(error <= 0.01);
        CHECK(r.reflected.mean + r.transmitted.mean + r.specular == Approx(1.0).margin(3.0 * error + 1e-9));
      }
    }
  }
}
