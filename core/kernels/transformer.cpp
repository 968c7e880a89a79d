#include "core/kernels/transformer.h"

#include <cmath>
#include <numbers>
#include <type_traits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "core/kernels/transformer.cpp"
#include <hwy/foreach_target.h>  // compiles the rest once an instruction set
#include <hwy/highway.h>

#include "core/kernels/masked_load-inl.h"
// After highway.h, once a target.
#include <hwy/contrib/math/math-inl.h>

HWY_BEFORE_NAMESPACE();
namespace opaline::kernels {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

/// Calls f(load, store) for every vector of n values, whole or the last part of one, whose other lanes load
/// as zero.
template <class D, class F>
HWY_INLINE void for_row(D d, int64_t n, const F& f) {
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

// The layer norm computes in double throughout: a vector of T is widened in two halves.
using Wide = hn::ScalableTag<double>;

/// Calls f(load, store) with double vectors for every few values of a row, beyond whose end `pad` is loaded.
template <class T, class F>
HWY_INLINE void for_wide_row(int64_t n, const F& f, double pad = 0.0) {
  const Wide d;
  const auto lanes = static_cast<int64_t>(hn::Lanes(d));
  alignas(64) double buffer[8] = {};  // for the last part of a row
  int64_t j = 0;
  for (; j + lanes <= n; j += lanes) {
    if constexpr (std::is_same_v<T, double>) {
      f([=](const T* p) HWY_ATTR { return hn::LoadU(d, p + j); },
        [=](auto v, T* p) HWY_ATTR { hn::StoreU(v, d, p + j); });
    } else {
      const hn::Rebind<T, Wide> narrow;
      f([=](const T* p) HWY_ATTR { return hn::PromoteTo(d, hn::LoadU(narrow, p + j)); },
        [=](auto v, T* p) HWY_ATTR { hn::StoreU(hn::DemoteTo(narrow, v), narrow, p + j); });
    }
  }
  if (j == n) return;
  f(
      [&](const T* p) HWY_ATTR {
        for (int64_t i = 0; i < lanes; ++i) buffer[i] = j + i < n ? static_cast<double>(p[j + i]) : pad;
        return hn::Load(d, buffer);
      },
      [&](auto v, T* p) HWY_ATTR {
        hn::Store(v, d, buffer);
        for (int64_t i = 0; j + i < n; ++i) p[j + i] = static_cast<T>(buffer[i]);
      });
}

template <class T>
HWY_ATTR RowSums row_moments(const T* x, int64_t n, double center) {
  const Wide d;
  const auto c = hn::Set(d, center);
  auto sum = hn::Zero(d), squares = hn::Zero(d);
  for_wide_row<T>(
      n,
      [&](const auto& load, const auto&) HWY_ATTR {
        const auto e = hn::Sub(load(x), c);
        sum = hn::Add(sum, e);
        squares = hn::MulAdd(e, e, squares);
      },
      center);
  return {hn::GetLane(hn::SumOfLanes(d, sum)), hn::GetLane(hn::SumOfLanes(d, squares))};
}

template <class T>
HWY_ATTR void normalize(const T* x, int64_t n, double mean, double inverse, const T* weight, const T* bias,
                        T* y) {
  const Wide d;
  const auto m = hn::Set(d, mean), i = hn::Set(d, inverse);
  for_wide_row<T>(n, [&](const auto& load, const auto& store) HWY_ATTR {
    store(hn::MulAdd(hn::Mul(hn::Sub(load(x), m), i), load(weight), load(bias)), y);
  });
}

template <class T>
HWY_ATTR RowSums normalize_sums(const T* x, const T* dy, int64_t n, double mean, const T* weight) {
  const Wide d;
  const auto m = hn::Set(d, mean);
  auto sum = hn::Zero(d), product = hn::Zero(d);
  for_wide_row<T>(n, [&](const auto& load, const auto&) HWY_ATTR {
    const auto g = hn::Mul(load(dy), load(weight));
    sum = hn::Add(sum, g);
    product = hn::MulAdd(g, hn::Sub(load(x), m), product);
  });
  return {hn::GetLane(hn::SumOfLanes(d, sum)), hn::GetLane(hn::SumOfLanes(d, product))};
}

template <class T>
HWY_ATTR void normalize_gradient(const T* x, const T* dy, int64_t n, double mean, double inverse,
                                 const T* weight, double a, double b, T* dx) {
  const Wide d;
  const auto m = hn::Set(d, mean), i = hn::Set(d, inverse), offset = hn::Set(d, a), slope = hn::Set(d, b);
  for_wide_row<T>(n, [&](const auto& load, const auto& store) HWY_ATTR {
    const auto rest = hn::MulAdd(slope, hn::Sub(load(x), m), offset);
    store(hn::Mul(i, hn::Sub(hn::Mul(load(dy), load(weight)), rest)), dx);
  });
}

template <class T>
HWY_ATTR void normalize_parameter_sums(const T* x, const T* dy, int64_t n, double mean, double inverse,
                                       double* weight_sums, double* bias_sums) {
  const Wide d;
  const auto lanes = static_cast<int64_t>(hn::Lanes(d));
  const auto m = hn::Set(d, mean), i = hn::Set(d, inverse);
  int64_t j = 0;
  for_wide_row<T>(n, [&](const auto& load, const auto&) HWY_ATTR {
    const auto g = load(dy);
    const auto w = hn::Mul(g, hn::Mul(hn::Sub(load(x), m), i));
    const auto count = static_cast<size_t>(n - j < lanes ? n - j : lanes);
    const auto mask = hn::FirstN(d, count);
    hn::BlendedStore(hn::Add(masked_load(mask, d, weight_sums + j), w), mask, d, weight_sums + j);
    hn::BlendedStore(hn::Add(masked_load(mask, d, bias_sums + j), g), mask, d, bias_sums + j);
    j += lanes;
  });
}

/// exp(x), of NaN too, which hn::Exp makes zero.
template <class D, class V>
HWY_INLINE V exponential(D d, V x) {
  return hn::IfThenElse(hn::IsNaN(x), x, hn::Exp(d, x));
}

/// exp(x), `scale` applied before, minus the largest; their sum.
template <class T>
HWY_ATTR void softmax(const T* x, int64_t n, T scale, T* y) {
  const hn::ScalableTag<T> d;
  // Scaled values go through memory: fused with the subtraction below they would not be rounded, and the
  // largest would differ from itself.
  const auto s = hn::Set(d, scale);
  for_row(d, n, [&](const auto& load, const auto& store) HWY_ATTR { store(hn::Mul(load(x), s), y); });
  T largest = y[0];
  for (int64_t j = 1; j < n; ++j) largest = y[j] > largest ? y[j] : largest;
  const auto top = hn::Set(d, largest);
  double total = 0.0;
  if constexpr (std::is_same_v<T, double>) {
    for (int64_t j = 0; j < n; ++j) {
      y[j] = std::exp(y[j] - largest);
      total += y[j];
    }
  } else {
    constexpr int64_t kPerFlush = 64;  // vectors summed in T before double takes over
    auto sum = hn::Zero(d);
    int64_t done = 0, held = 0;
    const auto lanes = static_cast<int64_t>(hn::Lanes(d));
    const auto flush = [&]() HWY_ATTR {
      alignas(64) T parts[16];
      hn::Store(sum, d, parts);
      for (int64_t i = 0; i < lanes; ++i) total += static_cast<double>(parts[i]);
      sum = hn::Zero(d);
      held = 0;
    };
    for_row(d, n, [&](const auto& load, const auto& store) HWY_ATTR {
      const auto e = exponential(d, hn::Sub(load(y), top));
      store(e, y);
      const auto inside = hn::FirstN(d, static_cast<size_t>(n - done < lanes ? n - done : lanes));
      sum = hn::Add(sum, hn::IfThenElseZero(inside, e));
      done += lanes;
      if (++held == kPerFlush) flush();
    });
    flush();
  }
  const auto inverse = hn::Set(d, static_cast<T>(1.0 / total));  // total >= 1: the largest term is 1
  for_row(d, n, [&](const auto& load, const auto& store) HWY_ATTR { store(hn::Mul(load(y), inverse), y); });
}

template <class T>
HWY_ATTR void softmax_gradient(const T* y, const T* dy, int64_t n, T scale, T* dx) {
  const Wide wide;
  auto sum = hn::Zero(wide);
  for_wide_row<T>(n,
                  [&](const auto& load, const auto&) HWY_ATTR { sum = hn::MulAdd(load(y), load(dy), sum); });
  const hn::ScalableTag<T> d;
  const auto dot = hn::Set(d, static_cast<T>(hn::GetLane(hn::SumOfLanes(wide, sum))));
  const auto s = hn::Set(d, scale);
  for_row(d, n, [&](const auto& load, const auto& store) HWY_ATTR {
    store(hn::Mul(hn::Mul(s, load(y)), hn::Sub(load(dy), dot)), dx);
  });
}

/// erfc(z) by the Chebyshev fit of Press et al., Numerical Recipes (2nd edition, section 6.2), relative
/// error 1.2e-7.
template <class D, class V>
HWY_INLINE V erfc(D d, V z) {
  constexpr float kFit[] = {0.17087277F,  -0.82215223F, 1.48851587F, -1.13520398F, 0.27886807F,
                            -0.18628806F, 0.09678418F,  0.37409196F, 1.00002368F,  -1.26551223F};
  const auto a = hn::Abs(z);
  const auto t = hn::Div(hn::Set(d, 1.0F), hn::MulAdd(hn::Set(d, 0.5F), a, hn::Set(d, 1.0F)));
  auto p = hn::Set(d, kFit[0]);
  for (size_t i = 1; i < 10; ++i) p = hn::MulAdd(p, t, hn::Set(d, kFit[i]));
  const auto tail = hn::Mul(t, exponential(d, hn::NegMulAdd(a, a, p)));
  return hn::IfThenElse(hn::Lt(z, hn::Zero(d)), hn::Sub(hn::Set(d, 2.0F), tail), tail);
}

template <class T>
HWY_ATTR void gelu(const T* x, int64_t n, T* y) {
  if constexpr (std::is_same_v<T, double>) {
    for (int64_t j = 0; j < n; ++j) y[j] = x[j] * 0.5 * std::erfc(-x[j] / std::numbers::sqrt2);
  } else {
    const hn::ScalableTag<T> d;
    for_row(d, n, [&](const auto& load, const auto& store) HWY_ATTR {
      const auto v = load(x);
      const auto phi = hn::Mul(hn::Set(d, 0.5F), erfc(d, hn::Mul(v, hn::Set(d, -0.70710678118654752F))));
      store(hn::Mul(v, phi), y);  // NaN for minus infinity, as PyTorch's
    });
  }
}

template <class T>
HWY_ATTR void gelu_gradient(const T* x, const T* dy, int64_t n, T* dx) {
  if constexpr (std::is_same_v<T, double>) {
    for (int64_t j = 0; j < n; ++j) {
      const double cdf = 0.5 * std::erfc(-x[j] / std::numbers::sqrt2);
      const double pdf = std::exp(-0.5 * x[j] * x[j]) * std::numbers::inv_sqrtpi / std::numbers::sqrt2;
      dx[j] = dy[j] * (cdf + x[j] * pdf);  // NaN for an infinite x, as PyTorch's
    }
  } else {
    const hn::ScalableTag<T> d;
    for_row(d, n, [&](const auto& load, const auto& store) HWY_ATTR {
      const auto v = load(x);
      const auto cdf = hn::Mul(hn::Set(d, 0.5F), erfc(d, hn::Mul(v, hn::Set(d, -0.70710678118654752F))));
      const auto pdf = hn::Mul(hn::Set(d, 0.39894228040143268F),
                               exponential(d, hn::Mul(hn::Mul(v, v), hn::Set(d, -0.5F))));
      store(hn::Mul(load(dy), hn::MulAdd(v, pdf, cdf)), dx);
    });
  }
}

template <class T>
TransformerKernels<T> make_transformer_kernels() {
  return {&softmax<T>,        &softmax_gradient<T>,   &gelu<T>,
          &gelu_gradient<T>,  &row_moments<T>,        &normalize<T>,
          &normalize_sums<T>, &normalize_gradient<T>, &normalize_parameter_sums<T>};
}

TransformerKernels<float> make_float_transformer_kernels() {
  return make_transformer_kernels<float>();
}
TransformerKernels<double> make_double_transformer_kernels() {
  return make_transformer_kernels<double>();
}

}  // namespace HWY_NAMESPACE
}  // namespace opaline::kernels
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace opaline::kernels {

HWY_EXPORT(make_float_transformer_kernels);
HWY_EXPORT(make_double_transformer_kernels);

template <>
const TransformerKernels<float>& transformer_kernels<float>() {
  static const TransformerKernels<float> best = HWY_DYNAMIC_DISPATCH(make_float_transformer_kernels)();
  return best;
}

template <>
const TransformerKernels<double>& transformer_kernels<double>() {
  static const TransformerKernels<double> best = HWY_DYNAMIC_DISPATCH(make_double_transformer_kernels)();
  return best;
}

}  // namespace opaline::kernels
#endif
