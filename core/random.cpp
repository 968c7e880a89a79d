#include "core/random.h"

#include <cmath>
#include <numbers>
#include <utility>

namespace opaline {

std::array<uint32_t, 4> philox(std::array<uint32_t, 4> c, std::array<uint32_t, 2> k) {
  constexpr uint64_t kMultiplier0 = 0xD2511F53, kMultiplier1 = 0xCD9E8D57;
  constexpr uint32_t kWeyl0 = 0x9E3779B9, kWeyl1 = 0xBB67AE85;
  for (int round = 0; round < 10; ++round) {
    const uint64_t p0 = kMultiplier0 * c[0];
    const uint64_t p1 = kMultiplier1 * c[2];
    c = {static_cast<uint32_t>(p1 >> 32) ^ c[1] ^ k[0], static_cast<uint32_t>(p1),
         static_cast<uint32_t>(p0 >> 32) ^ c[3] ^ k[1], static_cast<uint32_t>(p0)};
    k[0] += kWeyl0;
    k[1] += kWeyl1;
  }
  return c;
}

Random::Random(uint64_t seed, Purpose purpose, uint32_t epoch, uint32_t sample)
    : key_{static_cast<uint32_t>(seed), static_cast<uint32_t>(seed >> 32)},
      // The first word counts blocks: 2^34 numbers a stream.
      counter_{0, static_cast<uint32_t>(purpose), epoch, sample} {}

uint32_t Random::bits() {
  if (used_ == 4) {
    block_ = philox(counter_, key_);
    ++counter_[0];
    used_ = 0;
  }
  return block_[used_++];
}

double Random::uniform() {
  const uint64_t high = bits() >> 5, low = bits() >> 6;
  return static_cast<double>((high << 26) | low) * 0x1p-53;
}

float Random::uniform_float() {
  return static_cast<float>(bits() >> 8) * 0x1p-24F;
}

uint32_t Random::below(uint32_t n) {
  // Lemire's multiply and reject.
  uint64_t product = static_cast<uint64_t>(bits()) * n;
  if (static_cast<uint32_t>(product) < n) {
    const uint32_t threshold = (0U - n) % n;
    while (static_cast<uint32_t>(product) < threshold) product = static_cast<uint64_t>(bits()) * n;
  }
  return static_cast<uint32_t>(product >> 32);
}

double Random::normal() {
  const double u = 1.0 - uniform();  // in (0, 1]: the logarithm is finite
  const double v = uniform();
  return std::sqrt(-2.0 * std::log(u)) * std::cos(2.0 * std::numbers::pi * v);
}

void shuffle(std::span<int64_t> items, Random& random) {
  for (auto i = static_cast<uint32_t>(items.size()); i > 1; --i)
    std::swap(items[i - 1], items[random.below(i)]);
}

}  // namespace opaline
