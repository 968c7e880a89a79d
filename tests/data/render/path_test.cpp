#include "data/render/path.h"

#include <catch2/catch.hpp>
#include <cmath>
#include <functional>

#include "core/error.h"
#include "data/render/mueller.h"
#include "data/render/render.h"
#include "data/render/validate.h"

using namespace opaline;
using namespace opaline::render;

namespace {

/// Within three standard errors, which themselves are small enough; false on NaN.
bool agrees(const Estimate& e, double expected, double largest_error) {
  return e.standard_error <= largest_error && std::abs(e.mean - expected) <= 3.0 * e.standard_error;
}

SlabResult slab(double albedo, double index, bool lambertian, double g, double tau, int64_t paths) {
  return validate_slab({.albedo = albedo,
                        .g = g,
                        .tau = tau,
                        .index = index,
                        .lambertian = lambertian,
                        .paths = paths,
                        .seed = 1});
}

/// Light that depends on the direction, so that nothing cancels.
class Gradient final : public Light {
 public:
  Rgb radiance(const Vec3&, const Vec3& d) const override {
    const double v = 1.0 + 0.8 * d.x + 0.1 * d.y + 0.3 * d.z * d.z;
    return {v, 1.9 - v * 0.5, 1.0};
  }
  Rgb background(const Vec3& d) const override { return radiance({}, d); }
};

/// The Stokes vector (first colour) that arrives against a ray, by recursion over both branches with dense
/// matrices: nothing in common with the tracer but the interface's Fresnel coefficients.
Stokes arriving(const Geometry& geometry, const Light& light, const Vec3& origin, const Vec3& direction,
                const Vec3& axis, bool inside, double carried) {
  if (carried < 1e-7) return {};
  Hit hit;
  if (!geometry.intersect(origin, direction, kInfinity, hit)) {
    return {light.radiance(origin, direction)[0], 0.0, 0.0, 0.0};
  }
  const double eta = inside ? 1.0 / kRefractiveIndex : kRefractiveIndex;
  const Fresnel f = fresnel(std::abs(dot(direction, hit.normal)), eta);
  Vec3 s = cross(hit.normal, direction);
  s = norm(s) > 1e-9 ? normalised(s) : axis;
  // The frame (s, k x s) of the light turned into the wanted one.
  const Vec3 k = -direction;
  const double angle = std::atan2(dot(axis, cross(k, s)), dot(axis, s));
  const Mueller to_axis = frame_rotation(angle);
  Stokes sum{};
  const auto add = [&](const Vec3& next, const Mueller& m, bool next_inside, double share) {
    const Stokes there =
        arriving(geometry, light, geometry.leave(hit, next), next, s, next_inside, carried * share);
    const Stokes here = render::apply(product(to_axis, m), there);
    for (size_t i = 0; i < 4; ++i) sum[i] += here[i];
  };
  add(reflect(direction, hit.normal), reflection(f), inside, f.reflectance());
  if (!f.total) {
    const Vec3 facing = dot(direction, hit.normal) < 0.0 ? hit.normal : -hit.normal;
    add(refract(direction, facing, f, eta), transmission(f), !inside, 1.0 - f.reflectance());
  }
  return sum;
}

/// A prism over a right-angled triangle, its hypotenuse towards +z.
Mesh right_prism() {
  return {
      .vertices = {{-1, -1, 0}, {1, -1, 0}, {0, -1, -1}, {-1, 1, 0}, {1, 1, 0}, {0, 1, -1}},
      .triangles = {{0, 1, 4}, {0, 4, 3}, {1, 2, 5}, {1, 5, 4}, {2, 0, 3}, {2, 3, 5}, {0, 2, 1}, {3, 4, 5}}};
}

Mesh box(const Vec3& low, const Vec3& high) {
  Mesh mesh = cube_sphere(1);
  for (auto& v : mesh.vertices) {
    v = {static_cast<float>(v[0] > 0 ? high.x : low.x), static_cast<float>(v[1] > 0 ? high.y : low.y),
         static_cast<float>(v[2] > 0 ? high.z : low.z)};
  }
  return mesh;
}

Mesh joined(Mesh a, const Mesh& b) {
  const auto shift = static_cast<uint32_t>(a.vertices.size());
  a.vertices.insert(a.vertices.end(), b.vertices.begin(), b.vertices.end());
  for (const auto& t : b.triangles) a.triangles.push_back({t[0] + shift, t[1] + shift, t[2] + shift});
  return a;
}

void compare_with_recursion(const Mesh& mesh, const Vec3& direction, const Vec3& target) {
  const auto geometry = make_mesh_geometry(mesh);
  const Gradient light;
  const World world{.geometry = geometry.get(), .light = &light};
  const Vec3 d = normalised(direction);
  const CameraRay ray{target - d * 5.0, d, basis_around(d).first};
  const Stokes expected = arriving(*geometry, light, ray.origin, d, ray.axis, false, 1.0);
  Random random(8, Purpose::kTest);
  PathFaults faults;
  constexpr int kCount = 4000;
  std::array<double, 3> sum{}, square{};
  for (int i = 0; i < kCount; ++i) {
    const PathSample sample = sample_path(world, ray, random, faults);
    REQUIRE(sample.hit);
    for (size_t k = 0; k < 3; ++k) {
      sum[k] += sample.clear[k][0];
      square[k] += sample.clear[k][0] * sample.clear[k][0];
    }
  }
  CHECK(faults.lost == 0);
  for (size_t k = 0; k < 3; ++k) {
    const double mean = sum[k] / kCount;
    const double error = std::sqrt(std::max(0.0, square[k] / kCount - mean * mean) / kCount);
    INFO("Stokes component " << k << ", standard error " << error);
    CHECK(error < 1e-3);
    CHECK(mean == Approx(expected[k]).margin(3.0 * error + 1e-6));
  }
  // The case is worth something only where polarisation matters.
  CHECK(std::abs(expected[1]) + std::abs(expected[2]) > 1e-3);
}

}  // namespace

TEST_CASE("slabs and half-spaces reflect what the literature says", "[statistics]") {
  // van de Hulst 1980: mu_a = 10, mu_s = 90, thickness 0.02.
  const SlabResult layer = slab(0.9, 1.0, false, 0.75, 2.0, 1'200'000);
  CHECK(agrees(layer.reflected, 0.09739, 0.003 * 0.09739));
  CHECK(agrees(layer.transmitted, 0.66096, 0.003 * 0.66096));
  // Giovanelli 1955, without the specular 0.04.
  const SlabResult giovanelli = slab(0.9, 1.5, false, 0.0, kInfinity, 400'000);
  CHECK(agrees(giovanelli.reflected, 0.2200, 0.003 * 0.22));
  CHECK(giovanelli.specular == Approx(0.04).epsilon(1e-6));
  // Chandrasekhar's H functions.
  CHECK(agrees(slab(0.5, 1.0, false, 0.0, kInfinity, 800'000).reflected, .11523, 0.003 * .11523));
  CHECK(agrees(slab(0.5, 1.0, true, 0.0, kInfinity, 500'000).reflected, .14654, 0.003 * .14654));
  CHECK(agrees(slab(0.9, 1.0, false, 0.0, kInfinity, 200'000).reflected, .41495, 0.003 * .41495));
  CHECK(agrees(slab(0.9, 1.0, true, 0.0, kInfinity, 200'000).reflected, .47802, 0.003 * .47802));
}

TEST_CASE("a slab that absorbs nothing loses nothing", "[statistics]") {
  const SlabResult r = slab(1.0, 1.5, true, 0.8, 3.0, 200'000);
  CHECK(r.reflected.mean + r.transmitted.mean + r.specular ==
        Approx(1.0).margin(3.0 * std::hypot(r.reflected.standard_error, r.transmitted.standard_error)));
}

TEST_CASE("slabs out of range are refused by name") {
  CHECK_THROWS_AS(slab(1.0, 1.0, false, 0.0, kInfinity, 100), UsageError);
  CHECK_THROWS_AS(slab(1.5, 1.0, false, 0.0, 1.0, 100), UsageError);
  CHECK_THROWS_AS(slab(0.5, 1.0, false, 1.0, 1.0, 100), UsageError);
  CHECK_THROWS_AS(slab(0.5, 0.5, false, 0.0, 1.0, 100), UsageError);
  CHECK_THROWS_AS(slab(0.5, 1.0, false, 0.0, std::nan(""), 100), UsageError);
}

TEST_CASE("the Fresnel table comes out of the renderer", "[statistics]") {
  for (const Figure& f : validate_fresnel(2'000'000)) {
    INFO(f.name << " " << f.value << " expected " << f.expected);
    CHECK(f.passes());
    CHECK(f.standard_error <= 0.003 * f.expected);
  }
}

TEST_CASE("white furnace: scenes that absorb nothing vanish in uniform light", "[statistics]") {
  for (uint32_t number = 0; number < 4; ++number) {
    const FurnaceResult r = validate_furnace({}, {.paths = 200'000, .seed = 2, .number = number});
    INFO(r.object << ": " << r.s0.mean << " +- " << r.s0.standard_error);
    CHECK(agrees(r.s0, 1.0, 0.003));
    CHECK(static_cast<double>(r.faults.lost) <= 1e-4 * static_cast<double>(r.faults.paths));
    for (size_t i = 0; i < 3; ++i) {
      INFO("clear, component " << i << ": " << r.clear[i].mean << " +- " << r.clear[i].standard_error);
      CHECK(agrees(r.clear[i], i == 0 ? 1.0 : 0.0, i == 0 ? 0.003 : 1e-4));
    }
  }
}

TEST_CASE("white furnace: an opaque layer vanishes, its polarisation too") {
  const auto layer = make_slab_geometry(12.0);
  Illumination light;
  light.environment = Environment(Rgb{1.0, 1.0, 1.0});
  const World world{.geometry = layer.get(),
                    .light = &light,
                    .medium = {.sigma_t = {1, 1, 1}, .albedo = {1, 1, 1}, .g = 0.5}};
  for (const double sine : {0.0, 0.5, 0.9, 0.99}) {
    const Vec3 d{sine, 0.0, -std::sqrt(1.0 - sine * sine)};
    Random random(1, Purpose::kTest);
    PathFaults faults;
    std::array<double, 3> sum{};
    constexpr int kCount = 2000;
    for (int i = 0; i < kCount; ++i) {
      const PathSample s = sample_path(world, {Vec3{} - d, d, {0, 1, 0}}, random, faults);
      for (size_t k = 0; k < 3; ++k) sum[k] += s.reflected[k][0] + s.unscattered[k][0] + s.scattered[k][0];
    }
    CHECK(sum[0] / kCount == Approx(1.0).margin(1e-4));
    CHECK(sum[1] / kCount == Approx(0.0).margin(1e-4));
    CHECK(sum[2] / kCount == Approx(0.0).margin(1e-4));
  }
}

TEST_CASE("polarisation in a prism with total reflections") {
  compare_with_recursion(right_prism(), {0.15, 0.35, -1.0}, {-0.3, 0.1, 0.0});
  compare_with_recursion(right_prism(), {-0.3, 0.2, -1.0}, {0.2, -0.2, 0.0});
}

TEST_CASE("polarisation between two facing planes") {
  const Mesh planes = joined(box({-3, -3, -1.5}, {3, 3, -1.0}), box({-3, 1.0, -1.0 + 0.25}, {3, 1.5, 4.0}));
  compare_with_recursion(planes, {0.2, 0.5, -0.8}, {0.0, 0.2, -1.0});
}

TEST_CASE("the guide changes the noise and not the mean", "[statistics]") {
  const SceneModel scene = draw_scene({.families = {Family::kHarmonics}}, {}, 3, 1);
  World plain = scene.world();
  World guided = plain;
  const Guide guide(guided, scene.light, scene.low, scene.high, Random(1, Purpose::kTest));
  guided.guide = &guide;
  const auto run = [&](const World& world, int count) {
    Random random(5, Purpose::kTest);
    PathFaults faults;
    double sum = 0.0, square = 0.0;
    for (int i = 0; i < count; ++i) {
      const PathSample s =
          sample_path(world, Camera{}.ray(32.0 + random.uniform(), 32.0 + random.uniform()), random, faults);
      REQUIRE(s.hit);
      sum += s.scattered[0][0];
      square += s.scattered[0][0] * s.scattered[0][0];
    }
    const double mean = sum / count;
    return Estimate{mean, std::sqrt((square / count - mean * mean) / count)};
  };
  const Estimate a = run(plain, 400'000), b = run(guided, 100'000);
  INFO(a.mean << " +- " << a.standard_error << " and " << b.mean << " +- " << b.standard_error);
  CHECK(std::abs(a.mean - b.mean) <= 3.5 * std::hypot(a.standard_error, b.standard_error));
  CHECK(b.standard_error / b.mean < 0.03);
  // At least nine times fewer samples for the same error.
  CHECK(a.standard_error * 2.0 > 3.0 * b.standard_error);
}

TEST_CASE("extreme media give finite light and no leaks") {
  SceneModel scene = draw_scene({}, {}, 4, 2);
  const Camera camera{.width = 8, .height = 8};
  for (const Medium& medium :
       {Medium{.sigma_t = {0.0, 1e-4, 1e4}, .albedo = {0.99, 0.999, 1.0}, .g = 1e-4},
        Medium{.sigma_t = {1e-4, 1.0, 100.0}, .albedo = {1.0, 1.0, 1.0}, .g = 0.99},
        Medium{.sigma_t = {5.0, 5.0, 5.0}, .albedo = {0.0, 0.5, 1.0}, .g = -0.8}, Medium{}}) {
    scene.medium = medium;
    const SceneRender r = render_scene(scene, camera, {.spp = 4, .photons = 500});
    for (const float v : r.image) REQUIRE(std::isfinite(v));
    for (const float v : r.bsdf) REQUIRE(std::isfinite(v));
    CHECK(r.faults.lost == 0);
  }
}
