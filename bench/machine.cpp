#include "bench/machine.h"

#include <omp.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <cstring>
#include <vector>

#include "core/parallel.h"

namespace opaline::bench {
namespace {

double seconds_since(std::chrono::steady_clock::time_point begin) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

constexpr int64_t kRounds = 4'000'000;
constexpr int kChains = 12;  // independent multiply-adds: more than latency x ports of any current core

typedef float Vector16 __attribute__((vector_size(64)));
typedef float Vector8 __attribute__((vector_size(32)));

// Contraction turns each line into one fused multiply-add.
template <class V>
__attribute__((always_inline)) inline float chains(float start) {
  V acc[kChains], factor = V{} + 0.999F, step = V{} + start;
  for (int i = 0; i < kChains; ++i) acc[i] = V{} + start * static_cast<float>(i);
  for (int64_t r = 0; r < kRounds; ++r) {
#pragma GCC unroll 12
    for (int i = 0; i < kChains; ++i) acc[i] = acc[i] * factor + step;
  }
  V sum{};
  for (int i = 0; i < kChains; ++i) sum += acc[i];
  return sum[0];
}

__attribute__((target("avx512f"))) float wide_chains(float start) {
  return chains<Vector16>(start);
}
__attribute__((target("avx2,fma"))) float narrow_chains(float start) {
  return chains<Vector8>(start);
}

}  // namespace

MachineLimits measure_machine() {
  MachineLimits limits;
  const bool wide = __builtin_cpu_supports("avx512f") != 0;
  const bool narrow = __builtin_cpu_supports("avx2") != 0 && __builtin_cpu_supports("fma") != 0;
  limits.instruction_set = wide ? "AVX-512" : narrow ? "AVX2" : "none of AVX2 and AVX-512";
  const int threads = num_threads();
  std::vector<float> sinks(static_cast<size_t>(threads));
  for (int repeat = 0; repeat < 3 && (wide || narrow); ++repeat) {
    const auto begin = std::chrono::steady_clock::now();
#pragma omp parallel num_threads(threads)
    {
      const int t = omp_get_thread_num();
      sinks[static_cast<size_t>(t)] = wide ? wide_chains(1e-3F) : narrow_chains(1e-3F);
    }
    const double operations = 2.0 * kRounds * kChains * (wide ? 16 : 8) * threads;
    limits.gflops = std::max(limits.gflops, 1e-9 * operations / seconds_since(begin));
  }

  // Far larger than any cache; each thread sums its own part.
  const std::vector<uint64_t> memory(size_t{1} << 25, 1);
  const auto part = static_cast<int64_t>(memory.size()) / threads;
  std::vector<uint64_t> sums(static_cast<size_t>(threads));
  for (int repeat = 0; repeat < 3; ++repeat) {
    const auto begin = std::chrono::steady_clock::now();
#pragma omp parallel num_threads(threads)
    {
      const int64_t t = omp_get_thread_num();
      uint64_t sum = 0;
      for (int64_t i = t * part; i < (t + 1) * part; ++i) sum += memory[static_cast<size_t>(i)];
      sums[static_cast<size_t>(t)] += sum;
    }
    const double bytes = 8.0 * static_cast<double>(part) * threads;
    limits.gigabytes_per_second = std::max(limits.gigabytes_per_second, 1e-9 * bytes / seconds_since(begin));
  }
  // Looked at, so that the loops are not dropped.
  if (sums[0] == 0 && sinks[0] == 0.0F) limits.gflops = 0.0;
  return limits;
}

}  // namespace opaline::bench
