#include "core/kernels/winograd_tile.h"

#include "core/error.h"
#include "core/kernels/winograd_points.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/kernels/winograd_tile.cpp"
#include <hwy/foreach_target.h>  // compiles the rest once an instruction set
#include <hwy/highway.h>

#include "core/kernels/masked_load-inl.h"

HWY_BEFORE_NAMESPACE();
namespace opaline::kernels {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

// The largest loop below has 8 turns: all are unrolled, so that coefficients become constants.

/// sum + c * x, where `first` says that there is no sum yet.
template <class D, class V>
HWY_INLINE V add_product(D d, bool first, V sum, double c, V x) {
  using T = hn::TFromD<D>;
  if (first) return c == 1.0 ? x : hn::Mul(hn::Set(d, static_cast<T>(c)), x);
  if (c == 1.0) return hn::Add(sum, x);
  if (c == -1.0) return hn::Sub(sum, x);
  return hn::MulAdd(hn::Set(d, static_cast<T>(c)), x, sum);
}

/// r = B^T x.
template <int kOutputs, class D, class V>
HWY_INLINE void transform_input(D d, const V* x, V* r) {
  using W = Winograd<kOutputs>;
  constexpr auto kAll = W::product(-1);
  V low = x[0], high = x[1];
#pragma GCC unroll 8
  for (int k = 0; k <= W::kPairs; ++k) {
    low = add_product(d, k == 0, low, kAll[static_cast<size_t>(k)], x[2 * k]);
    high = add_product(d, k == 0, high, kAll[static_cast<size_t>(k)], x[2 * k + 1]);
  }
  r[0] = low;
  r[W::kTile - 1] = high;
#pragma GCC unroll 8
  for (int i = 0; i < W::kPairs; ++i) {
    const auto rest = W::product(i);
    V even = x[0], odd = x[1];
#pragma GCC unroll 8
    for (int k = 0; k < W::kPairs; ++k) {
      const double c = rest[static_cast<size_t>(k)];
      even = add_product(d, k == 0, even, c, x[2 * k + 2]);
      odd = add_product(d, k == 0, odd, W::power(i, 1) * c, x[2 * k + 1]);
    }
    r[1 + 2 * i] = hn::Add(even, odd);
    r[2 + 2 * i] = hn::Sub(even, odd);
  }
}

/// r[point] = weight of the point * the polynomial of `kCount` coefficients x there: A x, and with weights
/// G x.
template <int kOutputs, int kCount, bool kWeights, class D, class V>
HWY_INLINE void evaluate(D d, const V* x, V* r) {
  using W = Winograd<kOutputs>;
  r[0] = add_product(d, true, x[0], kWeights ? W::zero_weight() : 1.0, x[0]);
  r[W::kTile - 1] = x[kCount - 1];
#pragma GCC unroll 8
  for (int i = 0; i < W::kPairs; ++i) {
    V even = x[0], odd = x[0];
#pragma GCC unroll 8
    for (int k = 0; k < kCount; ++k) {
      const double c = W::power(i, k) * (kWeights ? W::pair_weight(i) : 1.0);
      if (k % 2 == 0) {
        even = add_product(d, k == 0, even, c, x[k]);
      } else {
        odd = add_product(d, k == 1, odd, c, x[k]);
      }
    }
    r[1 + 2 * i] = hn::Add(even, odd);
    r[2 + 2 * i] = hn::Sub(even, odd);
  }
}

/// y[k] = sum over points of weight * p^k * x[point]: A^T x, and with weights G^T x.
template <int kOutputs, int kCount, bool kWeights, class D, class V>
HWY_INLINE void interpolate(D d, const V* x, V* y) {
  using W = Winograd<kOutputs>;
  V sum[W::kPairs], difference[W::kPairs];
#pragma GCC unroll 8
  for (int i = 0; i < W::kPairs; ++i) {
    sum[i] = hn::Add(x[1 + 2 * i], x[2 + 2 * i]);
    difference[i] = hn::Sub(x[1 + 2 * i], x[2 + 2 * i]);
  }
#pragma GCC unroll 8
  for (int k = 0; k < kCount; ++k) {
    V result = x[0];
    if (k == 0) result = add_product(d, true, result, kWeights ? W::zero_weight() : 1.0, x[0]);
#pragma GCC unroll 8
    for (int i = 0; i < W::kPairs; ++i) {
      const double c = W::power(i, k) * (kWeights ? W::pair_weight(i) : 1.0);
      result = add_product(d, k > 0 && i == 0, result, c, k % 2 == 0 ? sum[i] : difference[i]);
    }
    if (k == kCount - 1) result = hn::Add(result, x[W::kTile - 1]);
    y[k] = result;
  }
}

// In what follows a tile has the points of F(kPoints x kPoints, 3 x 3), and takes a kernel of kTaps x kTaps
// to kPoints + 3 - kTaps outputs a side.

template <class T, int kPoints>
HWY_ATTR void input(const T* const* from, int64_t pixel_stride, int64_t channels, T* to,
                    const Frequencies& f) {
  const hn::ScalableTag<T> d;
  using V = hn::Vec<decltype(d)>;
  constexpr int kTile = Winograd<kPoints>::kTile;
  const auto lanes = static_cast<int64_t>(hn::Lanes(d));
  for (int64_t c = 0; c < channels; c += lanes) {
    V half[kTile][kTile];
    const auto mask = hn::FirstN(d, static_cast<size_t>(channels - c));
    const bool whole = c + lanes <= channels;
#pragma GCC unroll 8
    for (int j = 0; j < kTile; ++j) {
      V x[kTile], r[kTile];
      const int64_t offset = j * pixel_stride + c;
#pragma GCC unroll 8
      for (int i = 0; i < kTile; ++i) {
        const T* const at = from[i] + offset;
        x[i] = whole ? hn::LoadU(d, at) : masked_load(mask, d, at);
      }
      transform_input<kPoints>(d, x, r);
#pragma GCC unroll 8
      for (int i = 0; i < kTile; ++i) half[i][j] = r[i];
    }
    T* const out = to + (f.first + c) / f.width * f.panel + (f.first + c) % f.width;
#pragma GCC unroll 8
    for (int i = 0; i < kTile; ++i) {
      V r[kTile];
      transform_input<kPoints>(d, half[i], r);
#pragma GCC unroll 8
      for (int j = 0; j < kTile; ++j) hn::StoreU(r[j], d, out + (i * kTile + j) * f.frequency);
    }
  }
}

template <class T, int kPoints, int kTaps>
HWY_ATTR void output_gradient(const T* const* from, int64_t pixel_stride, int64_t channels, T* to,
                              const Frequencies& f) {
  const hn::ScalableTag<T> d;
  using V = hn::Vec<decltype(d)>;
  constexpr int kTile = Winograd<kPoints>::kTile, kOutputs = kTile + 1 - kTaps;
  const auto lanes = static_cast<int64_t>(hn::Lanes(d));
  for (int64_t c = 0; c < channels; c += lanes) {
    V half[kTile][kOutputs];
    const auto mask = hn::FirstN(d, static_cast<size_t>(channels - c));
    const bool whole = c + lanes <= channels;
#pragma GCC unroll 8
    for (int j = 0; j < kOutputs; ++j) {
      V x[kOutputs], r[kTile];
      const int64_t offset = j * pixel_stride + c;
#pragma GCC unroll 8
      for (int i = 0; i < kOutputs; ++i) {
        const T* const at = from[i] + offset;
        x[i] = whole ? hn::LoadU(d, at) : masked_load(mask, d, at);
      }
      evaluate<kPoints, kOutputs, false>(d, x, r);
#pragma GCC unroll 8
      for (int i = 0; i < kTile; ++i) half[i][j] = r[i];
    }
    T* const out = to + (f.first + c) / f.width * f.panel + (f.first + c) % f.width;
#pragma GCC unroll 8
    for (int i = 0; i < kTile; ++i) {
      V r[kTile];
      evaluate<kPoints, kOutputs, false>(d, half[i], r);
#pragma GCC unroll 8
      for (int j = 0; j < kTile; ++j) hn::StoreU(r[j], d, out + (i * kTile + j) * f.frequency);
    }
  }
}

template <class T, int kPoints, int kTaps>
HWY_ATTR void output(const T* from, const Frequencies& f, int64_t channels, const T* bias, T* const* y,
                     int64_t pixel_stride, int64_t rows, int64_t columns) {
  const hn::ScalableTag<T> d;
  using V = hn::Vec<decltype(d)>;
  constexpr int kTile = Winograd<kPoints>::kTile, kOutputs = kTile + 1 - kTaps;
  const auto lanes = static_cast<int64_t>(hn::Lanes(d));
  for (int64_t c = 0; c < channels; c += lanes) {
    V half[kOutputs][kTile];
    const T* const in = from + (f.first + c) / f.width * f.panel + (f.first + c) % f.width;
#pragma GCC unroll 8
    for (int j = 0; j < kTile; ++j) {
      V x[kTile], r[kOutputs];
#pragma GCC unroll 8
      for (int i = 0; i < kTile; ++i) x[i] = hn::LoadU(d, in + (i * kTile + j) * f.frequency);
      interpolate<kPoints, kOutputs, false>(d, x, r);
#pragma GCC unroll 8
      for (int i = 0; i < kOutputs; ++i) half[i][j] = r[i];
    }
    const V offset = bias != nullptr ? hn::LoadU(d, bias + c) : hn::Zero(d);
    const bool whole = c + lanes <= channels && rows == kOutputs && columns == kOutputs;
    const auto mask = hn::FirstN(d, static_cast<size_t>(channels - c));
#pragma GCC unroll 8
    for (int i = 0; i < kOutputs; ++i) {
      V r[kOutputs];
      interpolate<kPoints, kOutputs, false>(d, half[i], r);
      if (whole) {
        T* const line = y[i] + c;
#pragma GCC unroll 8
        for (int j = 0; j < kOutputs; ++j) hn::StoreU(hn::Add(r[j], offset), d, line + j * pixel_stride);
      } else if (i < rows) {
        T* const line = y[i] + c;
#pragma GCC unroll 8
        for (int j = 0; j < kOutputs; ++j) {
          if (j < columns) hn::BlendedStore(hn::Add(r[j], offset), mask, d, line + j * pixel_stride);
        }
      }
    }
  }
}

template <class T, int kPoints, int kTaps>
HWY_ATTR void weight(const T* const* taps, int64_t offset, T* to, int64_t frequency) {
  const hn::ScalableTag<T> d;
  using V = hn::Vec<decltype(d)>;
  constexpr int kTile = Winograd<kPoints>::kTile;
  V half[kTile][kTaps];
#pragma GCC unroll 8
  for (int j = 0; j < kTaps; ++j) {
    V x[kTaps], r[kTile];
#pragma GCC unroll 8
    for (int i = 0; i < kTaps; ++i) x[i] = hn::LoadU(d, taps[kTaps * i + j] + offset);
    evaluate<kPoints, kTaps, true>(d, x, r);
#pragma GCC unroll 8
    for (int i = 0; i < kTile; ++i) half[i][j] = r[i];
  }
#pragma GCC unroll 8
  for (int i = 0; i < kTile; ++i) {
    V r[kTile];
    evaluate<kPoints, kTaps, true>(d, half[i], r);
#pragma GCC unroll 8
    for (int j = 0; j < kTile; ++j) hn::StoreU(r[j], d, to + (i * kTile + j) * frequency);
  }
}

template <class T, int kPoints, int kTaps>
HWY_ATTR void weight_gradient(const T* from, int64_t frequency, int64_t columns, T* g, int64_t filter) {
  const hn::ScalableTag<T> d;
  using V = hn::Vec<decltype(d)>;
  constexpr int kTile = Winograd<kPoints>::kTile;
  const auto lanes = static_cast<int64_t>(hn::Lanes(d));
  const auto mask = hn::FirstN(d, static_cast<size_t>(columns));
  const bool whole = columns >= lanes;
  V half[kTaps][kTile];
#pragma GCC unroll 8
  for (int j = 0; j < kTile; ++j) {
    V x[kTile], r[kTaps];
#pragma GCC unroll 8
    for (int i = 0; i < kTile; ++i) {
      const T* const at = from + (i * kTile + j) * frequency;
      x[i] = whole ? hn::LoadU(d, at) : masked_load(mask, d, at);
    }
    interpolate<kPoints, kTaps, true>(d, x, r);
#pragma GCC unroll 8
    for (int i = 0; i < kTaps; ++i) half[i][j] = r[i];
  }
  alignas(64) T taps[kTaps * kTaps][64 / sizeof(T)];
#pragma GCC unroll 8
  for (int i = 0; i < kTaps; ++i) {
    V r[kTaps];
    interpolate<kPoints, kTaps, true>(d, half[i], r);
#pragma GCC unroll 8
    for (int j = 0; j < kTaps; ++j) hn::Store(r[j], d, taps[kTaps * i + j]);
  }
  for (int64_t j = 0; j < columns && j < lanes; ++j) {
    for (int k = 0; k < kTaps * kTaps; ++k) g[j * filter + k] = taps[k][j];
  }
}

template <class T, int kPoints, int kTaps>
WinogradKernels<T> make_winograd_kernels() {
  constexpr int kTile = Winograd<kPoints>::kTile;
  return {kTile + 1 - kTaps,
          kTaps,
          kTile,
          static_cast<int64_t>(hn::Lanes(hn::ScalableTag<T>())),
          &input<T, kPoints>,
          &output_gradient<T, kPoints, kTaps>,
          &output<T, kPoints, kTaps>,
          &weight<T, kPoints, kTaps>,
          &weight_gradient<T, kPoints, kTaps>};
}

template <class T>
WinogradKernels<T> select(int outputs) {
  if (outputs == 2) return make_winograd_kernels<T, 2, 3>();
  if (outputs == 3) return make_winograd_kernels<T, 4, 4>();
  if (outputs == 4) return make_winograd_kernels<T, 4, 3>();
  return make_winograd_kernels<T, 6, 3>();
}

WinogradKernels<float> winograd_float(int outputs) {
  return select<float>(outputs);
}
WinogradKernels<double> winograd_double(int outputs) {
  return select<double>(outputs);
}

}  // namespace HWY_NAMESPACE
}  // namespace opaline::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace opaline::kernels {

HWY_EXPORT(winograd_float);
HWY_EXPORT(winograd_double);

namespace {

/// All of them, made once.
template <class T, class Select>
const WinogradKernels<T>& kept(int outputs, const Select& select) {
  static const WinogradKernels<T> kernels[] = {select(2), select(3), select(4), select(6)};
  for (const WinogradKernels<T>& k : kernels) {
    if (k.outputs == outputs) return k;
  }
  fail("winograd", "tiles of {} outputs", outputs);
}

}  // namespace

template <>
const WinogradKernels<float>& winograd_kernels<float>(int outputs) {
  return kept<float>(outputs, [](int m) { return HWY_DYNAMIC_DISPATCH(winograd_float)(m); });
}

template <>
const WinogradKernels<double>& winograd_kernels<double>(int outputs) {
  return kept<double>(outputs, [](int m) { return HWY_DYNAMIC_DISPATCH(winograd_double)(m); });
}

}  // namespace opaline::kernels
#endif
