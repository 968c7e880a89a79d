#include "core/kernels/norm.h"

#include <type_traits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/kernels/norm.cpp"
#include <hwy/foreach_target.h>  // compiles the rest once an instruction set
#include <hwy/highway.h>

#include "core/kernels/masked_load-inl.h"

HWY_BEFORE_NAMESPACE();
namespace opaline::kernels {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

/// to[i] += v[i] * w[i], or v[i] alone, all in double.
template <bool kProduct, class D, class V>
HWY_INLINE void accumulate(D d, V v, V w, double* to) {
  if constexpr (std::is_same_v<hn::TFromD<D>, double>) {
    const auto sum = hn::LoadU(d, to);
    hn::StoreU(kProduct ? hn::MulAdd(v, w, sum) : hn::Add(sum, v), d, to);
  } else {
#if HWY_TARGET == HWY_SCALAR
    *to += static_cast<double>(hn::GetLane(v)) * (kProduct ? static_cast<double>(hn::GetLane(w)) : 1.0);
#else
    const hn::Half<D> half;
    const hn::Rebind<double, hn::Half<D> > wide;
    const auto add = [wide](auto x, auto y, double* at) HWY_ATTR {
      const auto sum = hn::LoadU(wide, at), value = hn::PromoteTo(wide, x);
      hn::StoreU(kProduct ? hn::MulAdd(value, hn::PromoteTo(wide, y), sum) : hn::Add(sum, value), wide, at);
    };
    add(hn::LowerHalf(half, v), hn::LowerHalf(half, w), to);
    add(hn::UpperHalf(half, v), hn::UpperHalf(half, w), to + hn::Lanes(wide));
#endif
  }
}

/// Whole vectors, and at the end of a row what is left, zero beyond.
template <class D>
class Columns {
 public:
  using T = hn::TFromD<D>;
  using V = hn::Vec<D>;
  Columns(D d, int64_t columns)
      : d_(d),
        columns_(columns),
        lanes_(static_cast<int64_t>(hn::Lanes(d))),
        mask_(hn::FirstN(d, static_cast<size_t>(columns % static_cast<int64_t>(hn::Lanes(d))))) {}
  HWY_INLINE bool whole(int64_t j) const { return j + lanes_ <= columns_; }
  HWY_INLINE V load(const T* row, int64_t j) const {
    return whole(j) ? hn::LoadU(d_, row + j) : masked_load(mask_, d_, row + j);
  }
  HWY_INLINE void store(V v, T* row, int64_t j) const {
    if (whole(j)) {
      hn::StoreU(v, d_, row + j);
    } else {
      hn::BlendedStore(v, mask_, d_, row + j);
    }
  }

 private:
  D d_;
  int64_t columns_, lanes_;
  hn::Mask<D> mask_;
};

template <class T>
HWY_ATTR void moments(const T* x, int64_t rows, int64_t columns, const T* shift, double* sums) {
  const hn::ScalableTag<T> d;
  const auto lanes = static_cast<int64_t>(hn::Lanes(d));
  const Columns<decltype(d)> at(d, columns);
  double* const squares = sums + (columns + lanes - 1) / lanes * lanes;
  for (int64_t row = 0; row < rows; ++row, x += columns) {
    for (int64_t j = 0; j < columns; j += lanes) {
      const auto v = hn::Sub(at.load(x, j), at.load(shift, j));
      accumulate<false>(d, v, v, sums + j);
      accumulate<true>(d, v, v, squares + j);
    }
  }
}

template <class T>
HWY_ATTR void column_sums(const T* x, int64_t rows, int64_t columns, double* sums) {
  const hn::ScalableTag<T> d;
  const auto lanes = static_cast<int64_t>(hn::Lanes(d));
  const Columns<decltype(d)> at(d, columns);
  for (int64_t row = 0; row < rows; ++row, x += columns) {
    for (int64_t j = 0; j < columns; j += lanes) accumulate<false>(d, at.load(x, j), at.load(x, j), sums + j);
  }
}

/// (x - center) * scale * factor + offset, from x - center: the same bits wherever it is needed.
template <class At, class V, class T>
HWY_INLINE V mapped(const At& at, V centred, int64_t j, const ChannelMap<T>& map) {
  return hn::MulAdd(hn::Mul(centred, at.load(map.scale, j)), at.load(map.factor, j), at.load(map.offset, j));
}

template <class T>
HWY_ATTR void apply(const T* x, int64_t rows, int64_t columns, const ChannelMap<T>& map, T* y) {
  const hn::ScalableTag<T> d;
  const auto lanes = static_cast<int64_t>(hn::Lanes(d));
  const Columns<decltype(d)> at(d, columns);
  const auto zero = hn::Zero(d);
  for (int64_t row = 0; row < rows; ++row, x += columns, y += columns) {
    for (int64_t j = 0; j < columns; j += lanes) {
      const auto v = mapped(at, hn::Sub(at.load(x, j), at.load(map.center, j)), j, map);
      at.store(map.relu ? hn::IfThenZeroElse(hn::Lt(v, zero), v) : v, y, j);  // NaN passes
    }
  }
}

/// dy where the rectifier lets it through.
template <class D, class V, class At, class T>
HWY_INLINE V passed(D d, const At& at, V centred, const T* dy, int64_t j, const ChannelMap<T>& map) {
  const auto g = at.load(dy, j);
  if (!map.relu) return g;
  return hn::IfThenZeroElse(hn::Le(mapped(at, centred, j, map), hn::Zero(d)), g);
}

template <class T>
HWY_ATTR void gradient_sums(const T* x, const T* dy, int64_t rows, int64_t columns, const ChannelMap<T>& map,
                            double* sums) {
  const hn::ScalableTag<T> d;
  const auto lanes = static_cast<int64_t>(hn::Lanes(d));
  const Columns<decltype(d)> at(d, columns);
  double* const products = sums + (columns + lanes - 1) / lanes * lanes;
  for (int64_t row = 0; row < rows; ++row, x += columns, dy += columns) {
    for (int64_t j = 0; j < columns; j += lanes) {
      const auto v = hn::Sub(at.load(x, j), at.load(map.center, j));
      const auto g = passed(d, at, v, dy, j, map);
      accumulate<false>(d, g, g, sums + j);
      accumulate<true>(d, g, v, products + j);
    }
  }
}

template <class T>
HWY_ATTR void gradient(const T* x, const T* dy, int64_t rows, int64_t columns, const ChannelMap<T>& map,
                       const T* b, const T* c, T* dx) {
  const hn::ScalableTag<T> d;
  const auto lanes = static_cast<int64_t>(hn::Lanes(d));
  const Columns<decltype(d)> at(d, columns);
  for (int64_t row = 0; row < rows; ++row, x += columns, dy += columns, dx += columns) {
    for (int64_t j = 0; j < columns; j += lanes) {
      const auto v = hn::Sub(at.load(x, j), at.load(map.center, j));
      auto g = passed(d, at, v, dy, j, map);
      const auto scale = at.load(map.scale, j);
      if (b != nullptr) {
        g = hn::Sub(g, hn::MulAdd(at.load(b, j), hn::Mul(v, scale), at.load(c, j)));
      }
      at.store(hn::Mul(hn::Mul(g, scale), at.load(map.factor, j)), dx, j);
    }
  }
}

template <class T>
NormKernels<T> make_norm_kernels() {
  return {static_cast<int64_t>(hn::Lanes(hn::ScalableTag<T>())),
          &moments<T>,
          &apply<T>,
          &gradient_sums<T>,
          &gradient<T>,
          &column_sums<T>};
}

NormKernels<float> make_float_norm_kernels() {
  return make_norm_kernels<float>();
}
NormKernels<double> make_double_norm_kernels() {
  return make_norm_kernels<double>();
}

}  // namespace HWY_NAMESPACE
}  // namespace opaline::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace opaline::kernels {

HWY_EXPORT(make_float_norm_kernels);
HWY_EXPORT(make_double_norm_kernels);

template <>
const NormKernels<float>& norm_kernels<float>() {
  static const NormKernels<float> best = HWY_DYNAMIC_DISPATCH(make_float_norm_kernels)();
  return best;
}

template <>
const NormKernels<double>& norm_kernels<double>() {
  static const NormKernels<double> best = HWY_DYNAMIC_DISPATCH(make_double_norm_kernels)();
  return best;
}

}  // namespace opaline::kernels
#endif
