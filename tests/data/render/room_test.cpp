#include "data/render/room.h"

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <vector>

using namespace opaline;
using namespace opaline::render;

namespace {

Environment room_of(uint32_t number, const RoomOptions& options) {
  Random random(1, Purpose::kTest, 0, number);
  return make_room(random, options);
}

/// Brightness at the middles of all texels.
std::vector<double> texels(const Environment& room) {
  std::vector<double> values;
  for (int64_t i = 0; i < room.height(); ++i) {
    for (int64_t j = 0; j < room.width(); ++j) {
      const double latitude =
          3.14159265358979 * (static_cast<double>(i) + 0.5) / static_cast<double>(room.height());
      const double longitude =
          2.0 * 3.14159265358979 * ((static_cast<double>(j) + 0.5) / static_cast<double>(room.width()) - 0.5);
      const Rgb c = room.radiance({std::sin(latitude) * std::sin(longitude), std::cos(latitude),
                                   -std::sin(latitude) * std::cos(longitude)});
      values.push_back((c[0] + c[1] + c[2]) / 3.0);
    }
  }
  return values;
}

}  // namespace

TEST_CASE("a room is a function of its stream") {
  CHECK(room_of(1, {}).fluence() == room_of(1, {}).fluence());
  CHECK(room_of(1, {}).fluence() != room_of(2, {}).fluence());
}

TEST_CASE("lamps have the contrast and the size that were asked for") {
  const RoomOptions options{.contrast = {2000.0, 2000.0}, .lamp = {6.0, 6.0}};
  for (uint32_t number = 0; number < 12; ++number) {
    const Environment room = room_of(number, options);
    const std::vector<double> values = texels(room);
    CHECK(*std::max_element(values.begin(), values.end()) == Approx(2000.0).epsilon(1e-6));
    // A disc of 6 degrees has 2 pi (1 - cos 6) = 0.0344 sr; there are one to three, which may overlap.
    double lit = 0.0;
    for (size_t k = 0; k < values.size(); ++k) {
      const double row = static_cast<double>(k) / static_cast<double>(room.width());
      const double band = 3.14159265358979 / static_cast<double>(room.height());
      lit += std::clamp(values[k] / 2000.0, 0.0, 1.0) * std::sin(band * (std::floor(row) + 0.5)) * band *
             (2.0 * 3.14159265358979 / static_cast<double>(room.width()));
    }
    INFO(number);
    CHECK(lit > 0.0344 * 0.97);
    CHECK(lit < 0.0344 * 3.0 + 0.2);  // windows add up to a twentieth of their solid angle
  }
}

TEST_CASE("the smallest lamp is four texels wide") {
  CHECK(RoomOptions{.lamp = {2.0, 15.0}}.height() >= 180);
  CHECK(RoomOptions{.lamp = {10.0, 20.0}}.height() == 64);
  CHECK(RoomOptions{.lamp = {0.0, 20.0}}.height() == 720);
}

TEST_CASE("walls have a mean radiance of 1") {
  // Lamps as faint as the walls change little.
  double sum = 0.0;
  for (uint32_t number = 0; number < 40; ++number) {
    std::vector<double> values = texels(room_of(number, {.contrast = {1.0, 1.0}, .lamp = {6.0, 6.0}}));
    std::nth_element(values.begin(), values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2),
                     values.end());
    sum += values[values.size() / 2];
  }
  CHECK(sum / 40.0 == Approx(0.9).epsilon(0.2));
}
