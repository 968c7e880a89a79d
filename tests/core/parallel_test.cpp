#include "core/parallel.h"

#include <algorithm>
#include <atomic>
#include <catch2/catch.hpp>
#include <stdexcept>
#include <string>
#include <vector>

#include "core/error.h"

namespace opaline {
namespace {

TEST_CASE("every unit runs once, whatever the number of threads") {
  for (const int threads : {1, 2, 5}) {
    const ThreadsGuard guard(threads);
    CHECK(num_threads() == threads);
    for (const int64_t n : {0, 1, 7, 1000}) {
      std::vector<int> runs(static_cast<size_t>(n), 0);
      parallel_for(n, [&](int64_t i) { ++runs[static_cast<size_t>(i)]; });
      CHECK(std::count(runs.begin(), runs.end(), 1) == n);
    }
  }
}

TEST_CASE("blocks cover a range without gaps and do not depend on threads") {
  const auto blocks_on = [](int threads, int64_t n, int64_t block) {
    const ThreadsGuard guard(threads);
    std::vector<int64_t> ends(static_cast<size_t>((n + block - 1) / block), -1);
    parallel_blocks(n, block, [&](int64_t begin, int64_t end) {
      REQUIRE(begin % block == 0);
      ends[static_cast<size_t>(begin / block)] = end;
    });
    return ends;
  };
  CHECK(blocks_on(1, 10, 4) == std::vector<int64_t>{4, 8, 10});
  CHECK(blocks_on(3, 10, 4) == std::vector<int64_t>{4, 8, 10});
  CHECK(blocks_on(3, 8, 4) == std::vector<int64_t>{4, 8});
  CHECK(blocks_on(2, 0, 4).empty());
}

TEST_CASE("an exception of a unit arrives, after the others have run") {
  for (const int threads : {2, 4}) {
    const ThreadsGuard guard(threads);
    std::atomic<int> others = 0;
    const auto run = [&] {
      parallel_for(100, [&](int64_t i) {
        if (i == 17) fail("unit", "number {}", i);
        ++others;
      });
    };
    CHECK_THROWS_WITH(run(), "[unit] number 17");
    CHECK(others == 99);
    others = 0;
    parallel_for(10, [&](int64_t) { ++others; });  // and the threads are still there
    CHECK(others == 10);
  }
  CHECK_THROWS_AS(parallel_for(1, [](int64_t) { throw std::runtime_error("one"); }), std::runtime_error);
}

TEST_CASE("the number of threads comes back") {
  const int before = num_threads();
  {
    const ThreadsGuard guard(before + 3);
    CHECK(num_threads() == before + 3);
  }
  CHECK(num_threads() == before);
  set_num_threads(0);
  CHECK(num_threads() >= 1);
  set_num_threads(before);
}

}  // namespace
}  // namespace opaline
