#include "data/render/sequence.h"

#include <catch2/catch.hpp>

using namespace opaline;
using namespace opaline::render;

TEST_CASE("a sequence's points are uniform, and more even than independent ones") {
  Random random(1, Purpose::kTest);
  constexpr int kCount = 4096, kBoxes = 8;
  const Sequence<2> sequence(random);
  std::array<std::array<int, kBoxes>, kBoxes> counts{};
  for (int i = 0; i < kCount; ++i) {
    const auto x = sequence.at(i);
    for (const double value : x) REQUIRE((value >= 0.0 && value < 1.0));
    ++counts[static_cast<size_t>(x[0] * kBoxes)][static_cast<size_t>(x[1] * kBoxes)];
  }
  // 64 a box; independent points would be off by 8.
  for (const auto& row : counts)
    for (const int count : row) CHECK(std::abs(count - 64) <= 6);
  // Each point alone is uniform over shifts.
  double first = 0.0;
  for (int i = 0; i < 10'000; ++i) first += Sequence<5>(random).at(17)[4];
  CHECK(first / 10'000 == Approx(0.5).margin(4.0 * 0.29 / 100.0));
}
