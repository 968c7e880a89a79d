#include "core/check/machine.h"

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstring>
#include <vector>

#include "core/parallel.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/check/machine.cpp"
#include <hwy/foreach_target.h>  // compiles the rest once an instruction set
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace opaline {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

/// `rounds` times twelve independent fused multiply-adds: enough to fill two pipelines of latency four to
/// six. Each starts elsewhere, or the compiler would compute equal ones once. Returns something that depends
/// on all of them, so that none is left out.
HWY_ATTR float multiply_adds(int64_t rounds) {
  const hn::ScalableTag<float> d;
  const auto a = hn::Set(d, 0.999F), b = hn::Set(d, 1e-3F);
  const auto start = [&](int i) HWY_ATTR { return hn::Set(d, 0.1F * static_cast<float>(i)); };
  auto x0 = start(0), x1 = start(1), x2 = start(2), x3 = start(3), x4 = start(4), x5 = start(5),
       x6 = start(6), x7 = start(7), x8 = start(8), x9 = start(9), x10 = start(10), x11 = start(11);
  for (int64_t i = 0; i < rounds; ++i) {
    x0 = hn::MulAdd(x0, a, b);
    x1 = hn::MulAdd(x1, a, b);
    x2 = hn::MulAdd(x2, a, b);
    x3 = hn::MulAdd(x3, a, b);
    x4 = hn::MulAdd(x4, a, b);
    x5 = hn::MulAdd(x5, a, b);
    x6 = hn::MulAdd(x6, a, b);
    x7 = hn::MulAdd(x7, a, b);
    x8 = hn::MulAdd(x8, a, b);
    x9 = hn::MulAdd(x9, a, b);
    x10 = hn::MulAdd(x10, a, b);
    x11 = hn::MulAdd(x11, a, b);
  }
  const auto sum = hn::Add(
      hn::Add(hn::Add(x0, x1), hn::Add(x2, x3)),
      hn::Add(hn::Add(hn::Add(x4, x5), hn::Add(x6, x7)), hn::Add(hn::Add(x8, x9), hn::Add(x10, x11))));
  return hn::GetLane(hn::SumOfLanes(d, sum));
}

int64_t lanes() {
  return static_cast<int64_t>(hn::Lanes(hn::ScalableTag<float>()));
}

const char* name() {
  return hwy::TargetName(HWY_TARGET);
}

}  // namespace HWY_NAMESPACE
}  // namespace opaline
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace opaline {

HWY_EXPORT(multiply_adds);
HWY_EXPORT(lanes);
HWY_EXPORT(name);

namespace {

constexpr int kRepeats = 5;

template <class F>
double best_seconds(const F& f) {
  double best = 1e30;
  for (int i = 0; i < kRepeats; ++i) {
    const auto begin = std::chrono::steady_clock::now();
    f();
    best = std::min(best, std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count());
  }
  return best;
}

double measure_gflops() {
  constexpr int64_t kRounds = 4'000'000, kChains = 12;
  const int threads = num_threads();
  std::vector<float> results(static_cast<size_t>(threads));
  const double seconds = best_seconds([&] {
    parallel_for(threads, [&](int64_t i) {
      results[static_cast<size_t>(i)] = HWY_DYNAMIC_DISPATCH(multiply_adds)(kRounds);
    });
  });
  const auto operations =
      static_cast<double>(2 * kRounds * kChains * HWY_DYNAMIC_DISPATCH(lanes)() * threads);
  return 1e-9 * operations / seconds;
}

double measure_copy() {
  constexpr int64_t kBytes = int64_t{1} << 28, kBlock = int64_t{1} << 20;
  std::vector<char> from(static_cast<size_t>(kBytes), 'x'), to(static_cast<size_t>(kBytes));
  const double seconds = best_seconds([&] {
    parallel_blocks(kBytes, kBlock, [&](int64_t begin, int64_t end) {
      std::memcpy(to.data() + begin, from.data() + begin, static_cast<size_t>(end - begin));
    });
  });
  return 1e-9 * 2.0 * static_cast<double>(kBytes) / seconds;
}

}  // namespace

Machine measure_machine() {
  return {.gflops = measure_gflops(),
          .gigabytes_per_second = measure_copy(),
          .instruction_set = HWY_DYNAMIC_DISPATCH(name)()};
}

}  // namespace opaline
#endif
