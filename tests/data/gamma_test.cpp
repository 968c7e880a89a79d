#include "data/gamma.h"

#include <hwy/targets.h>

#include "tests/data/support.h"

namespace opaline::test {
namespace {

/// Every `stride`-th float from 2^-126 to 1, and 1.
std::vector<float> floats_up_to_one(uint32_t stride) {
  std::vector<float> values;
  for (uint32_t bits = 0x00800000; bits <= 0x3f800000; bits += stride) {
    float value = 0;
    std::memcpy(&value, &bits, sizeof(value));
    values.push_back(value);
  }
  values.push_back(1.0F);
  return values;
}

double reference(float linear) {
  return std::pow(static_cast<double>(linear), 1 / 2.2);
}

TEST_CASE("the vectorised root is within 3e-7 of double precision", "[gamma]") {
  const std::vector<float> linear = floats_up_to_one(1009);
  std::vector<float> encoded(linear.size());
  encode_gamma(linear, encoded.data());
  double worst = 0;
  for (size_t i = 0; i < linear.size(); ++i) {
    const double v = reference(linear[i]);
    const double error = std::abs(static_cast<double>(encoded[i]) - v) / v;
    if (!(error <= worst)) worst = error;
  }
  CHECK(worst <= 3e-7);
  CHECK(worst > 0);  // else nothing was compared
  CHECK(encoded.back() == 1.0F);
}

TEST_CASE("the root is defined for every float", "[gamma]") {
  const float infinity = std::numeric_limits<float>::infinity();
  const std::vector<float> odd = {-1.0F, -0.0F, 0.0F, std::nanf(""), infinity, -infinity, 2.0F, 1e-45F};
  std::vector<float> encoded(odd.size());
  encode_gamma(odd, encoded.data());
  CHECK(encoded == std::vector<float>{0, 0, 0, 0, 1, 0, 1, 0});
  encode_network(odd, encoded.data());
  CHECK(encoded == std::vector<float>{-1, -1, -1, -1, 1, -1, 1, -1});
  encode_8bit(odd, encoded.data());
  CHECK(encoded == std::vector<float>{0, 0, 0, 0, 255, 0, 255, 0});
}

TEST_CASE("8-bit levels are exactly those of double precision", "[gamma]") {
  std::vector<float> linear = floats_up_to_one(2003);
  // Where it is hard: the floats around every step.
  for (int level = 1; level <= 255; ++level) {
    auto x = static_cast<float>(std::pow(level / 255.0, 2.2));
    for (int i = 0; i < 20; ++i) x = std::nextafter(x, 0.0F);
    for (int i = 0; i < 40; ++i) {
      linear.push_back(x);
      x = std::nextafter(x, 2.0F);
    }
  }
  std::vector<float> levels(linear.size()), network(linear.size());
  encode_8bit(linear, levels.data());
  encode_network_8bit(linear, network.data());
  for (size_t i = 0; i < linear.size(); ++i) {
    const double level = linear[i] >= 1.0F ? 255.0 : std::floor(255.0 * reference(linear[i]));
    INFO("I = " << linear[i]);
    REQUIRE(static_cast<double>(levels[i]) == level);
    REQUIRE(network[i] == static_cast<float>(2.0 * level / 255.0 - 1.0));
  }
}

TEST_CASE("a level's light has that level", "[gamma]") {
  for (int level = 0; level <= 255; ++level) {
    const float light = decode_8bit(static_cast<uint8_t>(level));
    float back = -1;
    encode_8bit({&light, 1}, &back);
    CHECK(static_cast<int>(back) == level);
  }
}

TEST_CASE("neither length, place nor instruction set changes a bit of the root", "[gamma]") {
  const std::vector<float> linear = floats_up_to_one(200003);
  std::vector<float> whole(linear.size());
  encode_network(linear, whole.data());
  for (const size_t length : {1U, 3U, 7U, 17U, 33U}) {
    for (size_t begin = 0; begin + length <= linear.size(); begin += 61) {
      std::vector<float> part(length);
      encode_network({linear.data() + begin, length}, part.data());
      REQUIRE(std::equal(part.begin(), part.end(), whole.begin() + static_cast<std::ptrdiff_t>(begin)));
    }
  }
  const std::vector<int64_t> targets = hwy::SupportedAndGeneratedTargets();
  const auto choose = [](int64_t mask) {
    hwy::SetSupportedTargetsForTest(mask);
    hwy::GetChosenTarget().Update(hwy::SupportedTargets());
  };
  for (const int64_t target : targets) {
    choose(target);
    std::vector<float> other(linear.size());
    encode_network(linear, other.data());
    INFO(hwy::TargetName(target));
    CHECK(other == whole);
  }
  choose(0);
}

}  // namespace
}  // namespace opaline::test
