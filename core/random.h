// Counter-based random numbers: Philox4x32-10 (Salmon, Moraes, Dror, Shaw, "Parallel random numbers: as easy
// as 1, 2, 3", SC 2011). A stream is a pure function of its key; there is no hidden or shared state, so
// nothing depends on the order of threads or workers.
#pragma once

#include <array>
#include <cstdint>
#include <span>

namespace opaline {

/// What a stream is for. Part of the key, so that two uses of one seed never share numbers.
enum class Purpose : uint32_t {
  kTest = 0,
  kInit = 1,      ///< weights; sample = parameter index
  kShuffle = 2,   ///< order of an epoch
  kScene = 3,     ///< scene parameters; sample = scene
  kRender = 4,    ///< light transport; epoch = pixel, sample = scene
  kSensor = 5,    ///< sensor model at load
  kValidate = 6,  ///< validation walks; sample = path block
  kBootstrap = 7  ///< confidence intervals
};

/// One Philox4x32-10 block of four 32-bit words.
std::array<uint32_t, 4> philox(std::array<uint32_t, 4> counter, std::array<uint32_t, 2> key);

/// A stream of random numbers keyed by (seed, purpose, epoch, sample). Cheap to make; copy freely.
class Random {
 public:
  Random(uint64_t seed, Purpose purpose, uint32_t epoch = 0, uint32_t sample = 0);

  /// Next 32 random bits.
  uint32_t bits();
  /// Uniform in [0, 1), 53 bits.
  double uniform();
  /// Uniform in [0, 1), 24 bits, never 1.
  float uniform_float();
  /// Uniform in [low, high).
  double uniform(double low, double high) { return low + (high - low) * uniform(); }
  /// Uniform integer in [0, n), without modulo bias; n > 0.
  uint32_t below(uint32_t n);
  /// Standard normal (Box-Muller).
  double normal();

 private:
  std::array<uint32_t, 2> key_;
  std::array<uint32_t, 4> counter_;
  std::array<uint32_t, 4> block_{};
  unsigned used_ = 4;
};

/// Fisher-Yates shuffle of `items` by the stream.
void shuffle(std::span<int64_t> items, Random& random);

}  // namespace opaline
