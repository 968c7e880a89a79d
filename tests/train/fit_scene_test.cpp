// Bringing captures to the network's size.
#include "train/fit_scene.h"

#include <catch2/catch.hpp>

namespace opaline {
namespace {

Scene ramp(int width, int height) {
  Scene scene;
  scene.width = width;
  scene.height = height;
  const auto pixels = static_cast<size_t>(scene.pixels());
  scene.image.resize(kStokesChannels * pixels);
  scene.mask.assign(pixels, 1);
  for (size_t i = 0; i < pixels; ++i) {
    for (size_t c = 0; c < kStokesChannels; ++c) {
      scene.image[kStokesChannels * i + c] =
          static_cast<float>(i % static_cast<size_t>(width)) + 100.0F * static_cast<float>(c);
    }
  }
  return scene;
}

TEST_CASE("a scene that fits is left alone") {
  const Scene scene = ramp(64, 48);
  const Scene same = fit_scene(scene, 64);
  CHECK(same.image == scene.image);
  CHECK(fit_scene(scene, 0).image == scene.image);
  CHECK(fit_scene(scene, 256).width == 64);
}

TEST_CASE("area averages are exact") {
  const Scene half = fit_scene(ramp(128, 128), 64);
  REQUIRE(half.width == 64);
  REQUIRE(half.height == 64);
  // Pixels 10 and 11 of the ramp become pixel 5.
  CHECK(half.image[kStokesChannels * 5 + 2] == Approx(210.5));
  // A factor of 1.5: pixel 1 takes half of pixel 1 and all of pixel 2.
  const Scene odd = fit_scene(ramp(96, 96), 64);
  CHECK(odd.image[kStokesChannels * 1] == Approx((0.5 * 1.0 + 2.0) / 1.5));
}

TEST_CASE("other shapes are padded, outside the mask") {
  const Scene fitted = fit_scene(ramp(200, 100), 64);
  CHECK(fitted.width == 64);
  CHECK(fitted.height == 32);
  const Scene small = fit_scene(ramp(40, 20), 0);
  REQUIRE(small.width == 48);
  REQUIRE(small.height == 32);
  CHECK(small.mask[0] == 0);
  CHECK(small.image[0] == 0.0F);
  const size_t inside = 6 * 48 + 4;  // the content starts at (4, 6)
  CHECK(small.mask[inside] == 1);
  CHECK(small.image[kStokesChannels * inside + 1] == 100.0F);
  CHECK(small.mask[inside - 1] == 0);
  CHECK(small.mask[inside - 48] == 0);
  size_t covered = 0;
  for (const uint8_t value : small.mask) covered += value;
  CHECK(covered == 40 * 20);
}

}  // namespace
}  // namespace opaline
