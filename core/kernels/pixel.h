// What resampling and pooling do with a few pixels, vectorised over channels, compiled for several
// instruction sets and chosen at run time. `n` channels, contiguous.
#pragma once

#include <cstdint>

namespace opaline::kernels {

template <class T>
struct PixelKernels {
  /// to = sum_{i < count} weights[i] * from[i], in order, starting from the first product.
  void (*combine)(const T* const* from, const T* weights, int64_t count, int64_t n, T* to) = nullptr;
  /// to = the largest of from[i]; NaN is larger than anything.
  void (*largest)(const T* const* from, int64_t count, int64_t n, T* to) = nullptr;
  /// to[i] = dy where from[i] is the first of the largest (the last NaN, if any), else 0.
  void (*largest_gradient)(const T* const* from, const T* dy, int64_t count, int64_t n,
                           T* const* to) = nullptr;
};

template <class T>
const PixelKernels<T>& pixel_kernels();

}  // namespace opaline::kernels
