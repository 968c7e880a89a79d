// Means and standard errors of many paths, the same to the bit for any number of threads.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <limits>
#include <vector>

#include "core/parallel.h"
#include "core/random.h"
#include "data/render/validate.h"

namespace opaline::render {

inline constexpr int64_t kPathsOfBlock = 4096;  ///< paths of one stream

/// Sums for the mean and variance of several numbers a path.
template <size_t N>
struct Moments {
  std::array<double, N> sum{}, square{};
  int64_t count = 0;

  void add(const std::array<double, N>& values) {
    for (size_t i = 0; i < N; ++i) {
      sum[i] += values[i];
      square[i] += values[i] * values[i];
    }
    ++count;
  }
  void join(const Moments& other) {
    for (size_t i = 0; i < N; ++i) {
      sum[i] += other.sum[i];
      square[i] += other.square[i];
    }
    count += other.count;
  }
  Estimate estimate(size_t i) const {
    if (count < 2) return {0.0, std::numeric_limits<double>::infinity()};
    const auto n = static_cast<double>(count);
    const double mean = sum[i] / n;
    const double variance = square[i] / n - mean * mean;
    // Rounding may leave a variance of zero below it; not a number stays one.
    return {mean, std::sqrt((variance < 0.0 ? 0.0 : variance) / (n - 1.0))};
  }
};

/// f(block's stream, block's sums, paths) over all blocks; joined in order.
template <class Sums, class F>
Sums run_blocks(int64_t paths, uint64_t seed, const F& f, int64_t block = kPathsOfBlock) {
  const int64_t blocks = (paths + block - 1) / block;
  std::vector<Sums> parts(static_cast<size_t>(blocks));
  parallel_for(blocks, [&](int64_t b) {
    Random random(seed, Purpose::kValidate, 0, static_cast<uint32_t>(b));
    f(random, parts[static_cast<size_t>(b)], std::min(block, paths - b * block));
  });
  Sums total;
  for (const Sums& part : parts) total.join(part);
  return total;
}

}  // namespace opaline::render
