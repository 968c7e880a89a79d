#include "core/random.h"

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <numeric>
#include <set>
#include <vector>

namespace opaline {
namespace {

using Block = std::array<uint32_t, 4>;

TEST_CASE("Philox gives the known answers of its authors") {
  // kat_vectors of the Random123 distribution, philox4x32 with 10 rounds.
  CHECK(philox({0, 0, 0, 0}, {0, 0}) == Block{0x6627e8d5, 0xe169c58d, 0xbc57ac4c, 0x9b00dbd8});
  constexpr uint32_t kOnes = 0xffffffff;
  CHECK(philox({kOnes, kOnes, kOnes, kOnes}, {kOnes, kOnes}) ==
        Block{0x408f276d, 0x41c83b0e, 0xa20bc7c6, 0x6d5451fd});
  CHECK(philox({0x243f6a88, 0x85a308d3, 0x13198a2e, 0x03707344}, {0xa4093822, 0x299f31d0}) ==
        Block{0xd16cfe09, 0x94fdcceb, 0x5001e420, 0x24126ea1});
}

TEST_CASE("a stream is its blocks in order") {
  const uint64_t seed = 0x123456789abcdef0;
  Random random(seed, Purpose::kShuffle, 7, 9);
  for (uint32_t block = 0; block < 3; ++block) {
    const Block expected =
        philox({block, static_cast<uint32_t>(Purpose::kShuffle), 7, 9}, {0x9abcdef0, 0x12345678});
    for (const uint32_t word : expected) CHECK(random.bits() == word);
  }
}

std::vector<uint32_t> first_words(Random random) {
  std::vector<uint32_t> words(64);
  for (uint32_t& word : words) word = random.bits();
  return words;
}

TEST_CASE("every part of the key makes another stream") {
  std::set<std::vector<uint32_t>> streams;
  std::set<uint32_t> words;
  size_t count = 0;
  const auto add = [&](const Random& random) {
    const auto list = first_words(random);
    streams.insert(list);
    words.insert(list.begin(), list.end());
    ++count;
  };
  for (const uint64_t seed : {uint64_t{0}, uint64_t{1}, uint64_t{1} << 32}) {
    for (const Purpose purpose : {Purpose::kTest, Purpose::kInit, Purpose::kShuffle}) {
      for (const uint32_t epoch : {0U, 1U}) {
        for (const uint32_t sample : {0U, 1U}) add(Random(seed, purpose, epoch, sample));
      }
    }
  }
  CHECK(streams.size() == count);
  // Of 2304 random words about 0.0006 pairs coincide: streams that overlapped would show.
  CHECK(words.size() == 64 * count);
  CHECK(first_words(Random(5, Purpose::kTest)) == first_words(Random(5, Purpose::kTest)));
}

TEST_CASE("a copy goes on where its original stood") {
  Random a(1, Purpose::kTest);
  a.bits();
  Random b = a;
  CHECK(a.bits() == b.bits());
  a.bits();
  Random c = a;
  CHECK(c.uniform() == a.uniform());
}

TEST_CASE("uniform numbers fill [0, 1) evenly") {
  Random random(1, Purpose::kTest);
  constexpr int kDraws = 100'000, kBins = 16;
  std::array<int, kBins> bins{};
  double low = 1.0, high = 0.0;
  for (int i = 0; i < kDraws; ++i) {
    const double u = random.uniform();
    low = std::min(low, u);
    high = std::max(high, u);
    ++bins[static_cast<size_t>(u * kBins)];
  }
  CHECK(low >= 0.0);
  CHECK(high < 1.0);
  double chi2 = 0.0;
  const double expected = static_cast<double>(kDraws) / kBins;
  for (const int n : bins) chi2 += (n - expected) * (n - expected) / expected;
  CHECK(chi2 < 37.7);  // the 0.1 % point for 15 degrees of freedom
  for (int i = 0; i < 1000; ++i) {
    const float f = random.uniform_float();
    CHECK((f >= 0.0F && f < 1.0F));
    const double v = random.uniform(-3.0, 2.0);
    CHECK((v >= -3.0 && v < 2.0));
  }
}

TEST_CASE("normal numbers have the moments of a normal distribution") {
  Random random(2, Purpose::kTest);
  constexpr int kDraws = 200'000;
  double sum = 0.0, squares = 0.0, fourth = 0.0;
  for (int i = 0; i < kDraws; ++i) {
    const double z = random.normal();
    REQUIRE(std::isfinite(z));
    sum += z;
    squares += z * z;
    fourth += z * z * z * z;
  }
  CHECK(std::abs(sum / kDraws) < 4.0 / std::sqrt(kDraws));
  CHECK(std::abs(squares / kDraws - 1.0) < 4.0 * std::sqrt(2.0 / kDraws));
  CHECK(std::abs(fourth / kDraws - 3.0) < 4.0 * std::sqrt(96.0 / kDraws));
}

TEST_CASE("integers below n are even") {
  Random random(3, Purpose::kTest);
  std::array<int, 3> counts{};
  for (int i = 0; i < 30'000; ++i) {
    const uint32_t v = random.below(3);
    REQUIRE(v < 3);
    ++counts[v];
  }
  for (const int n : counts) CHECK(std::abs(n - 10'000) < 400);
  for (int i = 0; i < 100; ++i) CHECK(random.below(1) == 0);
  // Three quarters of the range: without rejection every third value would come twice as often as the others.
  int thirds = 0;
  for (int i = 0; i < 9000; ++i) thirds += random.below(0xC0000000) % 3 == 0 ? 1 : 0;
  CHECK(std::abs(thirds - 3000) < 200);
}

TEST_CASE("a shuffle is a permutation that its stream decides") {
  std::vector<int64_t> a(100);
  std::iota(a.begin(), a.end(), 0);
  std::vector<int64_t> b = a, c = a;
  const std::vector<int64_t> sorted = a;
  Random one(1, Purpose::kShuffle, 0), same(1, Purpose::kShuffle, 0), next(1, Purpose::kShuffle, 1);
  shuffle(a, one);
  shuffle(b, same);
  shuffle(c, next);
  CHECK(a == b);
  CHECK(a != c);
  CHECK(a != sorted);
  std::sort(a.begin(), a.end());
  CHECK(a == sorted);
}

TEST_CASE("a shuffle reaches every order evenly") {
  std::array<int, 6> counts{};
  for (uint32_t i = 0; i < 6000; ++i) {
    std::vector<int64_t> items = {0, 1, 2};
    Random random(4, Purpose::kShuffle, i);
    shuffle(items, random);
    ++counts[static_cast<size_t>(items[0] * 2 + (items[1] > items[2] ? 1 : 0))];
  }
  for (const int n : counts) CHECK(std::abs(n - 1000) < 120);
}

}  // namespace
}  // namespace opaline
