#include "core/kernels/transpose.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/kernels/transpose.cpp"
#include <hwy/cache_control.h>
#include <hwy/foreach_target.h>  // compiles the rest once an instruction set
#include <hwy/highway.h>

#include "core/kernels/masked_load-inl.h"

HWY_BEFORE_NAMESPACE();
namespace opaline::kernels {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

#if HWY_TARGET == HWY_SCALAR

template <class T>
void square(const T* from, int64_t, int64_t rows, int64_t, T* to, int64_t) {
  *to = rows > 0 ? *from : T{};
}

#else

/// One square of as many rows and columns as a vector has lanes, of which `rows` and `columns` are there.
/// A round splits the even from the odd elements of all vectors in a row: it moves the lowest bit of an
/// element's number to the top. As many rounds as a lane's number has bits swap it with the vector's number.
template <class T>
HWY_ATTR void square(const T* from, int64_t from_stride, int64_t rows, int64_t columns, T* to,
                     int64_t to_stride) {
  const hn::ScalableTag<T> d;
  using V = hn::Vec<decltype(d)>;
  constexpr int kLanes = hn::MaxLanes(hn::ScalableTag<T>());
  const auto mask = hn::FirstN(d, static_cast<size_t>(columns));
  V v[kLanes], w[kLanes];
#pragma GCC unroll 16
  for (int i = 0; i < kLanes; ++i) {
    // Many rows far apart are more streams than the hardware looks ahead on.
    constexpr int64_t kAhead = 256 / sizeof(T);
    hwy::Prefetch(from + i * from_stride + kAhead);
    if (i >= rows) {
      v[i] = hn::Zero(d);
    } else {
      v[i] = columns >= kLanes ? hn::LoadU(d, from + i * from_stride)
                               : masked_load(mask, d, from + i * from_stride);
    }
  }
  for (int round = 1; round < kLanes; round *= 2) {
#pragma GCC unroll 16
    for (int i = 0; i < kLanes / 2; ++i) {
      w[i] = hn::ConcatEven(d, v[2 * i + 1], v[2 * i]);
      w[i + kLanes / 2] = hn::ConcatOdd(d, v[2 * i + 1], v[2 * i]);
    }
#pragma GCC unroll 16
    for (int i = 0; i < kLanes; ++i) v[i] = w[i];
  }
#pragma GCC unroll 16
  for (int j = 0; j < kLanes; ++j) {
    if (j < columns) hn::StoreU(v[j], d, to + j * to_stride);
  }
}

#endif

template <class T>
void run(const T* from, int64_t from_stride, int64_t rows, int64_t columns, T* to, int64_t to_stride,
         int64_t width) {
  const auto lanes = static_cast<int64_t>(hn::Lanes(hn::ScalableTag<T>()));
  for (int64_t j = 0; j < columns; j += lanes) {
    for (int64_t i = 0; i < width; i += lanes) {
      const int64_t here = i < rows ? i : 0;  // an address in memory where no row is left
      square(from + here * from_stride + j, from_stride, rows - i, columns - j, to + j * to_stride + i,
             to_stride);
    }
  }
}

void transpose_float(const float* from, int64_t from_stride, int64_t rows, int64_t columns, float* to,
                     int64_t to_stride, int64_t width) {
  run(from, from_stride, rows, columns, to, to_stride, width);
}
void transpose_double(const double* from, int64_t from_stride, int64_t rows, int64_t columns, double* to,
                      int64_t to_stride, int64_t width) {
  run(from, from_stride, rows, columns, to, to_stride, width);
}

}  // namespace HWY_NAMESPACE
}  // namespace opaline::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace opaline::kernels {

HWY_EXPORT(transpose_float);
HWY_EXPORT(transpose_double);

template <>
void transpose(const float* from, int64_t from_stride, int64_t rows, int64_t columns, float* to,
               int64_t to_stride, int64_t width) {
  HWY_DYNAMIC_DISPATCH(transpose_float)(from, from_stride, rows, columns, to, to_stride, width);
}

template <>
void transpose(const double* from, int64_t from_stride, int64_t rows, int64_t columns, double* to,
               int64_t to_stride, int64_t width) {
  HWY_DYNAMIC_DISPATCH(transpose_double)(from, from_stride, rows, columns, to, to_stride, width);
}

}  // namespace opaline::kernels
#endif
