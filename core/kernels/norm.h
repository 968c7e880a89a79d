// The passes over memory of normalisations per channel (batch and instance norm), vectorised over channels,
// compiled for several instruction sets and chosen at run time. x is rows x columns, contiguous. Sums are in
// double, one row after the other; `padded` is the number of columns up to a multiple of `lanes`, the
// distance of two arrays of sums.
#pragma once

#include <cstdint>

namespace opaline::kernels {

/// y = (x - center) * scale * factor + offset for each column; then, with `relu`, its positive part. The two
/// factors stay apart: their product underflows where values are huge and a weight is small.
template <class T>
struct ChannelMap {
  const T* center = nullptr;
  const T* scale = nullptr;
  const T* factor = nullptr;
  const T* offset = nullptr;
  bool relu = false;
};

template <class T>
struct NormKernels {
  int64_t lanes = 0;

  int64_t padded(int64_t columns) const { return (columns + lanes - 1) / lanes * lanes; }

  /// sums[j] += x - shift, sums[padded + j] += (x - shift)^2.
  void (*moments)(const T* x, int64_t rows, int64_t columns, const T* shift, double* sums) = nullptr;
  void (*apply)(const T* x, int64_t rows, int64_t columns, const ChannelMap<T>& map, T* y) = nullptr;
  /// With g = dy where y is not cut by the rectifier, else 0: sums[j] += g, sums[padded + j] += g * (x -
  /// center).
  void (*gradient_sums)(const T* x, const T* dy, int64_t rows, int64_t columns, const ChannelMap<T>& map,
                        double* sums) = nullptr;
  /// dx = factor * scale * (g - b * (x - center) * scale - c); where b and c are null factor * scale * g,
  /// whatever x is.
  void (*gradient)(const T* x, const T* dy, int64_t rows, int64_t columns, const ChannelMap<T>& map,
                   const T* b, const T* c, T* dx) = nullptr;
  /// sums[j] += x.
  void (*column_sums)(const T* x, int64_t rows, int64_t columns, double* sums) = nullptr;
};

template <class T>
const NormKernels<T>& norm_kernels();

}  // namespace opaline::kernels
