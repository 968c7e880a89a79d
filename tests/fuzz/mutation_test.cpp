// Thousands of damaged files for every parser: each must be read or refused, soon and without much memory.
// The mutations depend on the target and their number alone, so a failure comes again.
#include <sys/resource.h>

#include <algorithm>
#include <array>
#include <catch2/catch.hpp>
#include <ctime>
#include <string>

#include "core/file.h"
#include "core/random.h"
#include "tests/fuzz/targets.h"

namespace opaline::fuzz {
namespace {

constexpr uint32_t kMutants = 30000;  // a target
constexpr double kSeconds = 2.0;      // processor time of one input
constexpr int64_t kMegabytes = 512;   // growth of the process over all inputs
constexpr size_t kMaxBytes = 1 << 16;

double processor_seconds() {
  return static_cast<double>(std::clock()) / CLOCKS_PER_SEC;
}

int64_t peak_megabytes() {
  rusage usage{};
  ::getrusage(RUSAGE_SELF, &usage);
  return usage.ru_maxrss / 1024;
}

/// Numbers that sizes and offsets go wrong at.
constexpr std::array<uint64_t, 10> kEdges = {
    0, 1, 0x7F, 0x80, 0xFF, 0x7FFFFFFF, 0x80000000, 0xFFFFFFFF, 0x7FFFFFFFFFFFFFFF, UINT64_MAX};
constexpr std::array<std::string_view, 12> kWords = {
    "-1", "99999999999999999999", "1e999", "nan", "\"", "{", "[[[[[[[[", "}", "null", "\xff\xfe", ";", "\n"};

size_t position(const Bytes& bytes, Random& random) {
  return random.below(static_cast<uint32_t>(bytes.size()));
}

void flip_bit(Bytes& bytes, Random& random) {
  bytes[position(bytes, random)] ^= static_cast<std::byte>(1U << random.below(8));
}

void set_byte(Bytes& bytes, Random& random) {
  bytes[position(bytes, random)] = static_cast<std::byte>(random.below(256));
}

void cut(Bytes& bytes, Random& random) {
  bytes.resize(position(bytes, random));
}

/// Overwrites a little-endian number of 1, 2, 4 or 8 bytes.
void set_number(Bytes& bytes, Random& random) {
  const uint64_t value = kEdges[random.below(kEdges.size())] + random.below(2);
  const size_t width = size_t{1} << random.below(4), at = position(bytes, random);
  const bool big_endian = random.below(2) == 1;
  for (size_t i = 0; i < width && at + i < bytes.size(); ++i) {
    bytes[at + i] = static_cast<std::byte>((value >> (8 * (big_endian ? width - 1 - i : i))) & 0xFF);
  }
}

/// Repeats or removes a piece.
void repeat(Bytes& bytes, Random& random) {
  const size_t begin = position(bytes, random);
  const size_t length = std::min<size_t>(1 + random.below(32), bytes.size() - begin);
  const Bytes piece(bytes.begin() + static_cast<std::ptrdiff_t>(begin),
                    bytes.begin() + static_cast<std::ptrdiff_t>(begin + length));
  const auto to = bytes.begin() + static_cast<std::ptrdiff_t>(position(bytes, random));
  bytes.insert(to, piece.begin(), piece.end());
}

void remove(Bytes& bytes, Random& random) {
  const size_t begin = position(bytes, random);
  const size_t length = std::min<size_t>(1 + random.below(32), bytes.size() - begin);
  bytes.erase(bytes.begin() + static_cast<std::ptrdiff_t>(begin),
              bytes.begin() + static_cast<std::ptrdiff_t>(begin + length));
}

void insert_word(Bytes& bytes, Random& random) {
  const std::string_view word = kWords[random.below(kWords.size())];
  const auto piece = std::as_bytes(std::span(word.data(), word.size()));
  bytes.insert(bytes.begin() + static_cast<std::ptrdiff_t>(position(bytes, random)), piece.begin(),
               piece.end());
}

Bytes mutate(Bytes bytes, Random& random) {
  constexpr std::array<void (*)(Bytes&, Random&), 7> kWays = {flip_bit, set_byte, cut,        set_number,
                                                              repeat,   remove,   insert_word};
  const uint32_t changes = 1 + random.below(4);
  for (uint32_t i = 0; i < changes && !bytes.empty(); ++i) kWays[random.below(kWays.size())](bytes, random);
  if (bytes.size() > kMaxBytes) bytes.resize(kMaxBytes);
  return bytes;
}

TEST_CASE("the seeds of every parser are read") {
  for (const Target& target : targets()) {
    INFO(target.name);
    const auto seeds = target.seeds();
    REQUIRE(!seeds.empty());
    // The first one is valid; others may be there for their shape alone.
    CHECK_NOTHROW(target.parse(seeds[0]));
  }
}

TEST_CASE("damaged files are read or refused") {
  for (const Target& target : targets()) {
    DYNAMIC_SECTION(target.name) {
      const auto seeds = target.seeds();
      const uint64_t key = xxh64(std::as_bytes(std::span(target.name.data(), target.name.size())));
      const int64_t before = peak_megabytes();
      double slowest = 0.0;
      for (uint32_t i = 0; i < kMutants; ++i) {
        Random random(key, Purpose::kTest, 0, i);
        const Bytes bytes = mutate(seeds[i % seeds.size()], random);
        INFO("mutant " << i << " of " << bytes.size() << " bytes");
        const double begin = processor_seconds();
        REQUIRE_NOTHROW(run(target, bytes));
        slowest = std::max(slowest, processor_seconds() - begin);
      }
      INFO("slowest " << slowest << " s, grown by " << peak_megabytes() - before << " MiB");
      CHECK(slowest < kSeconds);
      CHECK(peak_megabytes() - before < kMegabytes);
    }
  }
}

TEST_CASE("noise is refused") {
  for (const Target& target : targets()) {
    INFO(target.name);
    for (uint32_t i = 0; i < 200; ++i) {
      Random random(1, Purpose::kTest, 1, i);
      Bytes bytes(random.below(300));
      for (std::byte& byte : bytes) byte = static_cast<std::byte>(random.below(256));
      REQUIRE_NOTHROW(run(target, bytes));
    }
    REQUIRE_NOTHROW(run(target, {}));
  }
}

}  // namespace
}  // namespace opaline::fuzz
