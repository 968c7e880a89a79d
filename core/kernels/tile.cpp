#include "core/kernels/tile.h"

#include <array>
#include <utility>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/kernels/tile.cpp"
#include <hwy/foreach_target.h>  // compiles the rest once an instruction set
#include <hwy/highway.h>

HWY_BEFORE_NAMESPACE();
namespace opaline::kernels {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

// Accumulators (rows x 2) have to fit the register file beside two vectors of b and a broadcast.
#if HWY_TARGET <= HWY_AVX3
constexpr int kRows = 8;
#else
constexpr int kRows = 4;
#endif

// Products summed in registers before they go to memory: a longer chain of roundings would cost digits.
constexpr int64_t kChain = 128;

template <class T, int kM, int kVectors>
HWY_ATTR void dot(const DotTile<T>& t) {
  const hn::ScalableTag<T> d;
  using V = hn::Vec<decltype(d)>;
  const auto lanes = static_cast<int64_t>(hn::Lanes(d));
  V acc[kM][kVectors];
  for (int v = 0; v < kVectors; ++v) {
    const V start = t.bias != nullptr ? hn::LoadU(d, t.bias + v * lanes) : hn::Zero(d);
    for (int i = 0; i < kM; ++i) acc[i][v] = start;
  }
  const auto flush = [&](bool add) HWY_ATTR {
    for (int v = 0; v < kVectors; ++v) {
      const int64_t left = t.columns - v * lanes;
      const auto mask = hn::FirstN(d, static_cast<size_t>(left < 0 ? 0 : left));
      for (int i = 0; i < kM; ++i) {
        T* const c = t.c + i * t.c_stride + v * lanes;
        if (left >= lanes) {
          hn::StoreU(add ? hn::Add(hn::LoadU(d, c), acc[i][v]) : acc[i][v], d, c);
        } else if (left > 0) {
          hn::BlendedStore(add ? hn::Add(hn::MaskedLoad(mask, d, c), acc[i][v]) : acc[i][v], mask, d, c);
        }
        acc[i][v] = hn::Zero(d);
      }
    }
  };
  const T* b = t.b;
  bool flushed = false;
  int64_t chain = 0;
  for (int64_t q = 0; q < t.runs; ++q) {
    const T* const run = t.a + q * t.a_run_stride;
    for (int64_t begin = 0; begin < t.run; begin += kChain) {
      const int64_t end = begin + kChain < t.run ? begin + kChain : t.run;
      if (chain + end - begin > kChain) {
        flush(flushed);
        flushed = true;
        chain = 0;
      }
      chain += end - begin;
      for (int64_t k = begin; k < end; ++k, b += kVectors * lanes) {
        V column[kVectors];
        for (int v = 0; v < kVectors; ++v) column[v] = hn::Load(d, b + v * lanes);
#pragma GCC unroll 16
        for (int i = 0; i < kM; ++i) {
          const V row = hn::Set(d, run[i * t.a_stride + k]);
          for (int v = 0; v < kVectors; ++v) acc[i][v] = hn::MulAdd(row, column[v], acc[i][v]);
        }
      }
    }
  }
  flush(flushed);
}

template <class T, int kM, int kVectors>
HWY_ATTR void outer(const OuterTile<T>& t) {
  const hn::ScalableTag<T> d;
  using V = hn::Vec<decltype(d)>;
  const auto lanes = static_cast<int64_t>(hn::Lanes(d));
  V acc[kM][kVectors];
  for (int v = 0; v < kVectors; ++v) {
    for (int i = 0; i < kM; ++i) acc[i][v] = hn::Zero(d);
  }
  for (int64_t y = 0; y < t.lines; ++y) {
    const T* a = t.a + y * t.a_line;
    const T* b = t.b + y * t.b_line;
    for (int64_t x = 0; x < t.pixels; ++x, a += t.a_stride, b += t.b_stride) {
      V row[kVectors];
      for (int v = 0; v < kVectors; ++v) row[v] = hn::LoadU(d, b + v * lanes);
#pragma GCC unroll 16
      for (int i = 0; i < kM; ++i) {
        const V value = hn::Set(d, a[i]);
        for (int v = 0; v < kVectors; ++v) acc[i][v] = hn::MulAdd(value, row[v], acc[i][v]);
      }
    }
  }
  for (int v = 0; v < kVectors; ++v) {
    const int64_t left = t.columns - v * lanes;
    const auto mask = hn::FirstN(d, static_cast<size_t>(left < 0 ? 0 : left));
    for (int i = 0; i < kM; ++i) {
      T* const c = t.c + i * t.c_stride + v * lanes;
      if (left >= lanes) {
        hn::StoreU(t.accumulate ? hn::Add(hn::LoadU(d, c), acc[i][v]) : acc[i][v], d, c);
      } else if (left > 0) {
        hn::BlendedStore(t.accumulate ? hn::Add(hn::MaskedLoad(mask, d, c), acc[i][v]) : acc[i][v], mask, d,
                         c);
      }
    }
  }
}

template <class T, int kVectors, size_t... kI>
constexpr auto dot_table(std::index_sequence<kI...>) {
  return std::array<void (*)(const DotTile<T>&), sizeof...(kI)>{
      &dot<T, static_cast<int>(kI) + 1, kVectors>...};
}

template <class T, int kVectors, size_t... kI>
constexpr auto outer_table(std::index_sequence<kI...>) {
  return std::array<void (*)(const OuterTile<T>&), sizeof...(kI)>{
      &outer<T, static_cast<int>(kI) + 1, kVectors>...};
}

using Rows = std::make_index_sequence<kRows>;

template <class T>
void run_dot(const DotTile<T>& tile, int64_t vectors) {
  static constexpr auto kOne = dot_table<T, 1>(Rows{});
  static constexpr auto kTwo = dot_table<T, 2>(Rows{});
  (vectors == 1 ? kOne : kTwo)[static_cast<size_t>(tile.rows - 1)](tile);
}

template <class T>
void run_outer(const OuterTile<T>& tile) {
  static constexpr auto kOne = outer_table<T, 1>(Rows{});
  static constexpr auto kTwo = outer_table<T, 2>(Rows{});
  const auto lanes = static_cast<int64_t>(hn::Lanes(hn::ScalableTag<T>()));
  (tile.columns <= lanes ? kOne : kTwo)[static_cast<size_t>(tile.rows - 1)](tile);
}

template <class T>
Tiles<T> make_tiles() {
  return {kRows, static_cast<int64_t>(hn::Lanes(hn::ScalableTag<T>())), &run_dot<T>, &run_outer<T>,
          hwy::TargetName(HWY_TARGET)};
}

Tiles<float> make_float_tiles() {
  return make_tiles<float>();
}
Tiles<double> make_double_tiles() {
  return make_tiles<double>();
}

}  // namespace HWY_NAMESPACE
}  // namespace opaline::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace opaline::kernels {

HWY_EXPORT(make_float_tiles);
HWY_EXPORT(make_double_tiles);

template <>
const Tiles<float>& tiles<float>() {
  static const Tiles<float> best = HWY_DYNAMIC_DISPATCH(make_float_tiles)();
  return best;
}

template <>
const Tiles<double>& tiles<double>() {
  static const Tiles<double> best = HWY_DYNAMIC_DISPATCH(make_double_tiles)();
  return best;
}

}  // namespace opaline::kernels
#endif
