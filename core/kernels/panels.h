// Weights as the dot tile reads them.
#pragma once

#include <hwy/cache_control.h>
#include <algorithm>
#include <cstdint>
#include <vector>

#include "core/kernels/scratch.h"
#include "core/kernels/tile.h"
#include "core/kernels/transpose.h"
#include "core/parallel.h"

namespace opaline::kernels {

/// Rows of a panel: to[r * width + j] = data[r * row_stride + j * column_stride] for r < rows and j < valid,
/// 0 for valid <= j < width. Asks for memory `ahead` rows on (0 for none), which the next call will read.
template <class T>
void pack_rows(const T* data, int64_t row_stride, int64_t column_stride, int64_t rows, int64_t valid,
               int64_t width, int64_t ahead, T* to) {
  if (row_stride == 1 && column_stride != 1) {
    transpose(data, column_stride, valid, rows, to, width, width);
    return;
  }
  constexpr int64_t kLine = 64 / sizeof(T);
  for (int64_t r = 0; r < rows; ++r) {
    const T* const from = data + r * row_stride;
    for (int64_t j = 0; ahead > 0 && j < valid; j += kLine) hwy::Prefetch(from + ahead * row_stride + j);
    if (column_stride == 1) {
      std::copy_n(from, valid, to + r * width);
    } else {
      for (int64_t j = 0; j < valid; ++j) to[r * width + j] = from[j * column_stride];
    }
    std::fill(to + r * width + valid, to + (r + 1) * width, T{});
  }
}

/// The weights of a (sub-)convolution as the dot tile wants them: panels of `width` output columns, each
/// [kernel_h][kernel_w * in][width], zero beyond the last column; biases padded alike.
template <class T>
struct PackedWeights {
  int64_t kernel_h, run, columns, vectors, width, panels;
  Scratch<T> values, bias;
  bool has_bias;

  PackedWeights(int64_t kernel_h_, int64_t run_, int64_t columns_, const T* bias_values)
      : kernel_h(kernel_h_),
        run(run_),
        columns(columns_),
        vectors(tiles<T>().vectors_for(columns)),
        width(vectors * tiles<T>().lanes),
        panels((columns + width - 1) / width),
        values(panels * kernel_h * run * width),
        bias(panels * width),
        has_bias(bias_values != nullptr) {
    bias.zero();
    if (bias_values != nullptr) std::copy_n(bias_values, columns, bias.data());
  }

  const T* panel(int64_t p) const { return values.data() + p * kernel_h * run * width; }

  /// From a matrix (one row of the kernel): element (r, j) at data[r * row_stride + j * column_stride].
  void fill(const T* data, int64_t row_stride, int64_t column_stride, bool parallel = true) {
    constexpr int64_t kRows = 256;  // of a unit
    const int64_t units = (run + kRows - 1) / kRows;
    for_units(panels * units, parallel, [&](int64_t unit) {
      const int64_t p = unit / units, begin = unit % units * kRows, end = std::min(run, begin + kRows);
      const int64_t valid = std::min(width, columns - p * width);
      const T* const from = data + begin * row_stride + p * width * column_stride;
      T* const to = values.data() + (p * run + begin) * width;
      pack_rows(from, row_stride, column_stride, end - begin, valid, width, 0, to);
    });
  }

 private:
  template <class F>
  static void for_units(int64_t n, bool parallel, const F& f) {
    if (parallel) {
      parallel_for(n, f);
    } else {
      for (int64_t unit = 0; unit < n; ++unit) f(unit);
    }
  }
};

/// Where a filter's tap has its place: position `at` (of channel 0, counted over all rows of the kernel) of
/// one of several packed weights; a negative one leaves it out.
struct TapPlace {
  size_t weights = 0;
  int64_t at = -1;
};

/// Packs filters of `taps` neighbouring values: that of channel c and column j begins at data[c *
/// channel_stride + j * column_stride]. `place` gives the TapPlace of a tap; channels follow each other. The
/// weights have the same columns.
template <class T, class F>
void fill_filters(std::vector<PackedWeights<T>>& weights, const T* data, int64_t channels,
                  int64_t channel_stride, int64_t column_stride, int64_t taps, const F& place) {
  constexpr int64_t kChannels = 16;  // of a unit
  const int64_t units = (channels + kChannels - 1) / kChannels;
  const int64_t width = weights.front().width, columns = weights.front().columns;
  std::vector<TapPlace> places;
  for (int64_t t = 0; t < taps; ++t) places.push_back(place(t));
  parallel_for(weights.front().panels * units, [&](int64_t unit) {
    const int64_t p = unit / units, begin = unit % units * kChannels;
    const int64_t valid = std::min(width, columns - p * width);
    const Scratch<T> filters(taps * width);
    for (int64_t c = begin; c < std::min(channels, begin + kChannels); ++c) {
      transpose(data + c * channel_stride + p * width * column_stride, column_stride, valid, taps,
                filters.data(), width, width);
      for (int64_t t = 0; t < taps; ++t) {
        const TapPlace& to = places[static_cast<size_t>(t)];
        if (to.at < 0) continue;
        const PackedWeights<T>& w = weights[to.weights];
        std::copy_n(filters.data() + t * width, width,
                    w.values.data() + (p * w.kernel_h * w.run + to.at + c) * width);
      }
    }
  });
}

}  // namespace opaline::kernels
