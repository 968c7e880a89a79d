// The transforms of Winograd's convolution F(m x m, r x r) (winograd_points.h) for single tiles, vectorised
// over channels, compiled for several instruction sets and chosen at run time. A tile has (m + r - 1)^2
// values a channel in both domains; position (i, j) of the transformed one is called frequency i * (m + r -
// 1) + j.
#pragma once

#include <cstdint>

namespace opaline::kernels {

/// Where the frequencies of a tile lie: value (frequency f, channel c) at
/// f * frequency + (first + c) / width * panel + (first + c) % width. `width` and `first` are multiples of
/// the lanes.
struct Frequencies {
  int64_t frequency = 0;
  int64_t panel = 0;
  int64_t width = 0;
  int64_t first = 0;
};

template <class T>
struct WinogradKernels {
  int64_t outputs = 0;  ///< m: pixels a side that a tile produces
  int64_t taps = 0;     ///< r: taps a side of the kernel
  int64_t tile = 0;     ///< m + r - 1
  int64_t lanes = 0;

  /// to = B^T d B for a patch d of tile x tile pixels, whose rows begin at d[0], d[1], ..; channels up to a
  /// multiple of the lanes become zero.
  void (*input)(const T* const* d, int64_t pixel_stride, int64_t channels, T* to,
                const Frequencies& f) = nullptr;
  /// to = A dy A^T for a patch dy of m x m pixels: the gradient of `output`.
  void (*output_gradient)(const T* const* dy, int64_t pixel_stride, int64_t channels, T* to,
                          const Frequencies& f) = nullptr;
  /// y = A^T from A + bias (of a multiple of the lanes, or null) for the first `rows` x `columns` pixels.
  void (*output)(const T* from, const Frequencies& f, int64_t channels, const T* bias, T* const* y,
                 int64_t pixel_stride, int64_t rows, int64_t columns) = nullptr;
  /// to = G g G^T for `lanes` filters: tap k of filter j at taps[k][offset + j].
  void (*weight)(const T* const* taps, int64_t offset, T* to, int64_t frequency) = nullptr;
  /// g = G^T from G, r * r contiguous values a filter for `columns` (at most the lanes) filters: the gradient
  /// of `weight`. Filters are `filter` apart.
  void (*weight_gradient)(const T* from, int64_t frequency, int64_t columns, T* g, int64_t filter) = nullptr;
};

/// By m: F(2 x 2, 3 x 3), F(3 x 3, 4 x 4), F(4 x 4, 3 x 3) or F(6 x 6, 3 x 3).
template <class T>
const WinogradKernels<T>& winograd_kernels(int outputs);

}  // namespace opaline::kernels
