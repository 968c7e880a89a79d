#include "data/render/guide.h"

#include <catch2/catch.hpp>
#include <cmath>

#include "data/render/path.h"
#include "data/render/solids.h"

using namespace opaline;
using namespace opaline::render;

namespace {

/// The guide of a box of those half-widths, in clear matter.
Guide guide_of_box(const Vec3& half) {
  const auto geometry = make_mesh_geometry(make_box(-half, half));
  Illumination light;
  light.environment = Environment(Rgb{1.0, 1.0, 1.0});
  const World world{.geometry = geometry.get(), .light = &light};
  return Guide(world, light, -half, half, Random(1, Purpose::kTest), {.photons = 2000});
}

}  // namespace

TEST_CASE("a guide gives unit directions and their density, however thin the body") {
  for (const Vec3& half :
       {Vec3{0.2, 0.2, 0.2}, Vec3{1e-3, 1e-3, 0.2}, Vec3{0.2, 0.2, 0.0}, Vec3{0.2, 0, 0}}) {
    INFO("half-widths " << half.x << " " << half.y << " " << half.z);
    const Guide guide = guide_of_box(half);
    Random random(2, Purpose::kTest);
    for (int i = 0; i < 200; ++i) {
      const Vec3 position{half.x * random.uniform(-1, 1), half.y * random.uniform(-1, 1),
                          half.z * random.uniform(-1, 1)};
      Vec3 direction;
      if (!guide.sample(position, random, direction)) continue;
      REQUIRE(norm(direction) == Approx(1.0));
      const double density = guide.density(position, direction);
      REQUIRE((density > 0.0 && std::isfinite(density)));
    }
  }
}

TEST_CASE("without light there is nowhere to be guided to") {
  const auto geometry = make_mesh_geometry(make_box({-1, -1, -1}, {1, 1, 1}));
  const Illumination dark;
  const World world{.geometry = geometry.get(), .light = &dark};
  const Guide guide(world, dark, {-1, -1, -1}, {1, 1, 1}, Random(1, Purpose::kTest));
  Random random(2, Purpose::kTest);
  Vec3 direction;
  CHECK_FALSE(guide.sample({0, 0, 0}, random, direction));
  CHECK(guide.density({0, 0, 0}, {0, 0, 1}) == 0.0);
  CHECK(Guide().density({0, 0, 0}, {0, 0, 1}) == 0.0);
}
