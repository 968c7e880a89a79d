#include "core/kernels/pixel.h"

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/kernels/pixel.cpp"
#include <hwy/foreach_target.h>  // compiles the rest once an instruction set
#include <hwy/highway.h>

#include "core/kernels/masked_load-inl.h"

HWY_BEFORE_NAMESPACE();
namespace opaline::kernels {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

/// Calls f(j, load, store) for every vector of channels, whole or the last part of one.
template <class D, class F>
HWY_INLINE void for_vectors(D d, int64_t n, const F& f) {
  using T = hn::TFromD<D>;
  const auto lanes = static_cast<int64_t>(hn::Lanes(d));
  int64_t j = 0;
  for (; j + lanes <= n; j += lanes) {
    f([=](const T* p) HWY_ATTR { return hn::LoadU(d, p + j); },
      [=](auto v, T* p) HWY_ATTR { hn::StoreU(v, d, p + j); });
  }
  if (j == n) return;
  const auto mask = hn::FirstN(d, static_cast<size_t>(n - j));
  f([=](const T* p) HWY_ATTR { return masked_load(mask, d, p + j); },
    [=](auto v, T* p) HWY_ATTR { hn::BlendedStore(v, mask, d, p + j); });
}

template <class T>
HWY_ATTR void combine(const T* const* from, const T* weights, int64_t count, int64_t n, T* to) {
  const hn::ScalableTag<T> d;
  for_vectors(d, n, [&](const auto& load, const auto& store) HWY_ATTR {
    auto sum = hn::Mul(load(from[0]), hn::Set(d, weights[0]));
    for (int64_t i = 1; i < count; ++i) sum = hn::MulAdd(load(from[i]), hn::Set(d, weights[i]), sum);
    store(sum, to);
  });
}

/// Whether v takes the place of the largest so far.
template <class V>
HWY_INLINE auto larger(V v, V best) {
  return hn::Or(hn::Gt(v, best), hn::IsNaN(v));
}

template <class T>
HWY_ATTR void largest(const T* const* from, int64_t count, int64_t n, T* to) {
  const hn::ScalableTag<T> d;
  for_vectors(d, n, [&](const auto& load, const auto& store) HWY_ATTR {
    auto best = load(from[0]);
    for (int64_t i = 1; i < count; ++i) {
      const auto v = load(from[i]);
      best = hn::IfThenElse(larger(v, best), v, best);
    }
    store(best, to);
  });
}

template <class T>
HWY_ATTR void largest_gradient(const T* const* from, const T* dy, int64_t count, int64_t n, T* const* to) {
  const hn::ScalableTag<T> d;
  for_vectors(d, n, [&](const auto& load, const auto& store) HWY_ATTR {
    auto best = load(from[0]);
    auto at = hn::Zero(d);
    for (int64_t i = 1; i < count; ++i) {
      const auto v = load(from[i]);
      const auto wins = larger(v, best);
      best = hn::IfThenElse(wins, v, best);
      at = hn::IfThenElse(wins, hn::Set(d, static_cast<T>(i)), at);
    }
    const auto g = load(dy);
    for (int64_t i = 0; i < count; ++i) {
      store(hn::IfThenElseZero(hn::Eq(at, hn::Set(d, static_cast<T>(i))), g), to[i]);
    }
  });
}

template <class T>
PixelKernels<T> make_pixel_kernels() {
  return {&combine<T>, &largest<T>, &largest_gradient<T>};
}

PixelKernels<float> make_float_pixel_kernels() {
  return make_pixel_kernels<float>();
}
PixelKernels<double> make_double_pixel_kernels() {
  return make_pixel_kernels<double>();
}

}  // namespace HWY_NAMESPACE
}  // namespace opaline::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace opaline::kernels {

HWY_EXPORT(make_float_pixel_kernels);
HWY_EXPORT(make_double_pixel_kernels);

template <>
const PixelKernels<float>& pixel_kernels<float>() {
  static const PixelKernels<float> best = HWY_DYNAMIC_DISPATCH(make_float_pixel_kernels)();
  return best;
}

template <>
const PixelKernels<double>& pixel_kernels<double>() {
  static const PixelKernels<double> best = HWY_DYNAMIC_DISPATCH(make_double_pixel_kernels)();
  return best;
}

}  // namespace opaline::kernels
#endif
