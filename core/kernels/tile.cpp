#include "core/kernels/tile.h"

#include <array>
#include <utility>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/kernels/tile.cpp"
#include <hwy/cache_control.h>
#include <hwy/foreach_target.h>  // compiles the rest once an instruction set
#include <hwy/highway.h>

#include "core/kernels/masked_load-inl.h"

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

/// A piece of a panel: positions [begin, end) of the runs [first, last).
struct Piece {
  int64_t first, last, begin, end;
  bool start;  // with the bias instead of what is there
};

/// A row of sums to memory, as far as there are columns; where `add`, onto what is there.
template <class T, int kVectors, class V>
HWY_INLINE HWY_ATTR void store(const V (&sums)[kVectors], int64_t columns, bool add, T* to) {
  const hn::ScalableTag<T> d;
  const auto lanes = static_cast<int64_t>(hn::Lanes(d));
  for (int v = 0; v < kVectors; ++v, columns -= lanes, to += lanes) {
    if (columns >= lanes) {
      hn::StoreU(add ? hn::Add(hn::LoadU(d, to), sums[v]) : sums[v], d, to);
    } else if (columns > 0) {
      const auto mask = hn::FirstN(d, static_cast<size_t>(columns));
      hn::BlendedStore(add ? hn::Add(masked_load(mask, d, to), sums[v]) : sums[v], mask, d, to);
    }
  }
}

// Every loop over rows is unrolled: sums that a variable indexes would live in memory.

/// kM rows of a line from row `row` on, over a piece of the panel.
template <class T, int kM, int kVectors>
HWY_ATTR void dot(const DotTile<T>& t, int64_t line, int64_t row, const Piece& piece) {
  const hn::ScalableTag<T> d;
  using V = hn::Vec<decltype(d)>;
  const auto lanes = static_cast<int64_t>(hn::Lanes(d));
  V column[kVectors], sums[kM][kVectors];
  for (int v = 0; v < kVectors; ++v) {
    column[v] = piece.start && t.bias != nullptr ? hn::LoadU(d, t.bias + v * lanes) : hn::Zero(d);
  }
#pragma GCC unroll 16
  for (int i = 0; i < kM; ++i) {
    for (int v = 0; v < kVectors; ++v) sums[i][v] = column[v];
  }
  const T* const a = t.a + line * t.a_line + row * t.a_stride;
  const T* b = t.b + (piece.first * t.run + piece.begin) * kVectors * lanes;
  for (int64_t q = piece.first; q < piece.last; ++q) {
    const T* const run = a + q * t.a_run_stride;
    for (int64_t k = piece.begin; k < piece.end; ++k, b += kVectors * lanes) {
      for (int v = 0; v < kVectors; ++v) column[v] = hn::Load(d, b + v * lanes);
#pragma GCC unroll 16
      for (int i = 0; i < kM; ++i) {
        const V value = hn::Set(d, run[i * t.a_stride + k]);
        for (int v = 0; v < kVectors; ++v) sums[i][v] = hn::MulAdd(value, column[v], sums[i][v]);
      }
    }
  }
  T* const c = t.c + line * t.c_line + row * t.c_stride;
#pragma GCC unroll 16
  for (int i = 0; i < kM; ++i) store<T, kVectors>(sums[i], t.columns, !piece.start, c + i * t.c_stride);
}

template <class T, int kM, int kVectors>
HWY_ATTR void outer(const OuterTile<T>& t) {
  const hn::ScalableTag<T> d;
  using V = hn::Vec<decltype(d)>;
  const auto lanes = static_cast<int64_t>(hn::Lanes(d));
  V row[kVectors], sums[kM][kVectors];
#pragma GCC unroll 16
  for (int i = 0; i < kM; ++i) {
    for (int v = 0; v < kVectors; ++v) {
      sums[i][v] = hn::Zero(d);
      hwy::Prefetch(t.c + i * t.c_stride + v * lanes);  // for the sums at the end
    }
  }
  for (int64_t y = 0; y < t.lines; ++y) {
    const T* a = t.a + y * t.a_line;
    const T* b = t.b + y * t.b_line;
    for (int64_t x = 0; x < t.pixels; ++x, a += t.a_stride, b += t.b_stride) {
      for (int v = 0; v < kVectors; ++v) row[v] = hn::LoadU(d, b + v * lanes);
#pragma GCC unroll 16
      for (int i = 0; i < kM; ++i) {
        const V value = hn::Set(d, a[i]);
        for (int v = 0; v < kVectors; ++v) sums[i][v] = hn::MulAdd(value, row[v], sums[i][v]);
      }
    }
  }
#pragma GCC unroll 16
  for (int i = 0; i < kM; ++i) store<T, kVectors>(sums[i], t.columns, t.accumulate, t.c + i * t.c_stride);
}

template <class T, int kVectors, size_t... kI>
constexpr auto dot_table(std::index_sequence<kI...>) {
  return std::array<void (*)(const DotTile<T>&, int64_t, int64_t, const Piece&), sizeof...(kI)>{
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
  const auto& table = vectors == 1 ? kOne : kTwo;
  const auto run_piece = [&](const Piece& piece) {
    for (int64_t line = 0; line < tile.lines; ++line) {
      for (int64_t row = 0; row < tile.rows; row += kRows) {
        table[static_cast<size_t>(tile.rows - row < kRows ? tile.rows - row : kRows) - 1](tile, line, row,
                                                                                          piece);
      }
    }
  };
  // Several short runs make a piece, or a part of a long one; parts are as even as they can be.
  const int64_t runs_each = tile.run < kChain ? kChain / (tile.run < 1 ? 1 : tile.run) : 1;
  const int64_t parts = (tile.run + kChain - 1) / kChain < 1 ? 1 : (tile.run + kChain - 1) / kChain;
  bool start = !tile.accumulate;
  for (int64_t q = 0; q < tile.runs; q += runs_each) {
    const int64_t last = q + runs_each < tile.runs ? q + runs_each : tile.runs;
    for (int64_t part = 0; part < parts; ++part) {
      run_piece({q, last, part * tile.run / parts, (part + 1) * tile.run / parts, start});
      start = false;
    }
  }
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
