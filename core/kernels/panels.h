// Weights as the dot tile reads them.
#pragma once

#include <algorithm>
#include <cstdint>

#include "core/kernels/scratch.h"
#include "core/kernels/tile.h"
#include "core/parallel.h"

namespace opaline::kernels {

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
    if (has_bias) std::copy_n(bias_values, columns, bias.data());
  }

  const T* panel(int64_t p) const { return values.data() + p * kernel_h * run * width; }

  /// Fills element (row q, position r in the run, column j) with at(q, r)[j * stride].
  template <class F>
  void fill(int64_t stride, const F& at, bool parallel = true) {
    const auto fill_row = [&](int64_t unit) {
      const int64_t p = unit / kernel_h, q = unit % kernel_h;
      T* to = values.data() + unit * run * width;
      const int64_t valid = std::min(width, columns - p * width);
      for (int64_t r = 0; r < run; ++r, to += width) {
        const T* const from = at(q, r) + p * width * stride;
        for (int64_t j = 0; j < valid; ++j) to[j] = from[j * stride];
        std::fill(to + valid, to + width, T{});
      }
    };
    if (parallel) {
      parallel_for(panels * kernel_h, fill_row);
    } else {
      for (int64_t unit = 0; unit < panels * kernel_h; ++unit) fill_row(unit);
    }
  }
};

}  // namespace opaline::kernels
