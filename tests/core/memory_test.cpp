#include "core/memory.h"

#include <catch2/catch.hpp>
#include <cstdint>
#include <thread>
#include <vector>

#include "core/error.h"

namespace opaline {
namespace {

TEST_CASE("the pool counts what is in use and its peak") {
  Pool pool;
  CHECK(pool.bytes_in_use() == 0);
  {
    const auto a = pool.allocate(1000);
    CHECK(reinterpret_cast<uintptr_t>(a.get()) % 64 == 0);
    const int64_t one = pool.bytes_in_use();
    CHECK(one >= 1000);
    CHECK(one <= 1125 + 64);  // at most an eighth over what was asked for
    {
      const auto b = pool.allocate(2000);
      CHECK(pool.bytes_in_use() >= one + 2000);
    }
    CHECK(pool.bytes_in_use() == one);
    CHECK(pool.peak_bytes() >= one + 2000);
    pool.reset_peak();
    CHECK(pool.peak_bytes() == one);
  }
  CHECK(pool.bytes_in_use() == 0);
  CHECK(pool.peak_bytes() > 0);
  pool.reset_peak();
  CHECK(pool.peak_bytes() == 0);
}

TEST_CASE("a freed block is handed out again for the same size") {
  Pool pool;
  const std::byte* first = nullptr;
  {
    const auto a = pool.allocate(5000);
    first = a.get();
  }
  const auto again = pool.allocate(5000);
  if (Pool::kReuses) CHECK(again.get() == first);
  // A second one at the same time is another block.
  const auto other = pool.allocate(5000);
  CHECK(other.get() != first);
}

TEST_CASE("copies of a pointer hold one block") {
  Pool pool;
  auto a = pool.allocate(64);
  const auto b = a;
  a.reset();
  CHECK(pool.bytes_in_use() == 64);
}

TEST_CASE("kept blocks can be given back") {
  Pool pool;
  {
    const auto a = pool.allocate(1 << 20);
    a.get()[0] = std::byte{1};
  }
  pool.release_cached();
  const auto b = pool.allocate(1 << 20);  // a fresh one
  b.get()[(1 << 20) - 1] = std::byte{2};
  CHECK(pool.bytes_in_use() == 1 << 20);
}

TEST_CASE("empty and impossible requests") {
  Pool pool;
  CHECK(pool.allocate(0) != nullptr);
  CHECK_THROWS_AS(pool.allocate(-1), Error);
  // More than any address space: refused, and not counted afterwards.
  CHECK_THROWS_WITH(pool.allocate(int64_t{1} << 60), Catch::Contains("out of memory"));
  CHECK_THROWS_AS(pool.allocate(INT64_MAX), Error);
  CHECK(pool.bytes_in_use() == 0);
}

TEST_CASE("several threads may use a pool") {
  Pool pool;
  std::vector<std::thread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&pool, t] {
      for (int i = 0; i < 500; ++i) {
        const auto block = pool.allocate(64 * (1 + (i + t) % 7));
        block.get()[0] = static_cast<std::byte>(t);
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
  CHECK(pool.bytes_in_use() == 0);
}

}  // namespace
}  // namespace opaline
