#include "data/gamma.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

#undef HWY_TARGET_INCLUDE
#define HWY_TARGET_INCLUDE "data/gamma.cpp"
#include <hwy/foreach_target.h>  // compiles the rest once an instruction set
#include <hwy/highway.h>

// What the instruction sets share; compiled once.
#ifndef OPALINE_DATA_GAMMA_TABLES
#define OPALINE_DATA_GAMMA_TABLES
namespace opaline::gamma {

constexpr double kExponent = 1 / 2.2;
constexpr size_t kExponents = 128;  // biased, of 0 to 1
constexpr size_t kLevels = 256;

struct Tables {
  std::array<float, kExponents> scale{};       ///< 2^((e - 127) / 2.2); 0 for e = 0
  std::array<float, kLevels + 1> threshold{};  ///< least I whose level is at least k; infinite at 256
  std::array<float, kLevels> network{};        ///< 2 k / 255 - 1
  std::array<float, kLevels> light{};          ///< decode_8bit

  Tables() {
    for (size_t e = 1; e < kExponents; ++e) {
      scale[e] = static_cast<float>(std::pow(2.0, (static_cast<double>(e) - 127.0) * kExponent));
    }
    const auto reaches = [](float x, double k) {
      return std::floor(255.0 * std::pow(static_cast<double>(x), kExponent)) >= k;
    };
    for (size_t i = 1; i < kLevels; ++i) {
      const auto k = static_cast<double>(i);
      auto x = static_cast<float>(std::pow(k / 255.0, 2.2));
      while (!reaches(x, k)) x = std::nextafter(x, 2.0F);
      while (reaches(std::nextafter(x, 0.0F), k)) x = std::nextafter(x, 0.0F);
      threshold[i] = x;
    }
    threshold[kLevels] = std::numeric_limits<float>::infinity();
    for (size_t i = 0; i < kLevels; ++i) {
      const auto k = static_cast<double>(i);
      network[i] = static_cast<float>(2.0 * k / 255.0 - 1.0);
      light[i] = static_cast<float>(std::min(1.0, std::pow((k + 0.5) / 255.0, 2.2)));
    }
  }
};

inline const Tables& tables() {
  static const Tables all;
  return all;
}

}  // namespace opaline::gamma
#endif

HWY_BEFORE_NAMESPACE();
namespace opaline::gamma {
namespace HWY_NAMESPACE {

namespace hn = hwy::HWY_NAMESPACE;

/// Clipped to [0, 1]; NaN to 0.
template <class D, class V = hn::Vec<D>>
HWY_ATTR V clip(D d, V x) {
  const V positive = hn::IfThenElseZero(hn::Gt(x, hn::Zero(d)), x);
  return hn::Min(positive, hn::Set(d, 1.0F));
}

/// x^(1/2.2) of x in [0, 1].
template <class D, class V = hn::Vec<D>>
HWY_ATTR V root(D d, V x, const Tables& tables) {
  const hn::RebindToSigned<D> di;
  const auto bits = hn::BitCast(di, x);
  const auto exponent = hn::ShiftRight<23>(bits);
  const auto mantissa = hn::Or(hn::And(bits, hn::Set(di, 0x007fffff)), hn::Set(di, 0x3f800000));
  const V t = hn::Sub(hn::BitCast(d, mantissa), hn::Set(d, 1.5F));
  V power = hn::Set(d, 0.0015187205281108618F);
  constexpr float kCoefficients[] = {-0.0026767058297991753F, 0.004488462116569281F, -0.009591921232640743F,
                                     0.02275819703936577F,    -0.06624988466501236F, 0.36435723304748535F,
                                     1.2023793458938599F};
  for (const float c : kCoefficients) power = hn::Add(hn::Mul(power, t), hn::Set(d, c));
  return hn::Mul(power, hn::GatherIndex(d, tables.scale.data(), exponent));
}

/// floor(255 x^(1/2.2)), as integers: the estimate is off by one at most, which the thresholds tell.
template <class D, class V = hn::Vec<D>>
HWY_ATTR hn::Vec<hn::RebindToSigned<D>> level(D d, V x, const Tables& tables) {
  const hn::RebindToSigned<D> di;
  const auto k =
      hn::Min(hn::ConvertTo(di, hn::Mul(root(d, x, tables), hn::Set(d, 255.0F))), hn::Set(di, 255));
  const auto low = hn::GatherIndex(d, tables.threshold.data(), k);
  const auto high = hn::GatherIndex(d, tables.threshold.data() + 1, k);
  const auto one = hn::Set(di, 1);
  const auto up = hn::IfThenElseZero(hn::RebindMask(di, hn::Ge(x, high)), one);
  const auto down = hn::IfThenElseZero(hn::RebindMask(di, hn::Lt(x, low)), one);
  return hn::Sub(hn::Add(k, up), down);
}

/// Applies f to all values, the last few in a vector padded with zeros.
template <class F>
HWY_ATTR void map(const float* from, float* to, size_t n, const F& f) {
  const hn::ScalableTag<float> d;
  const size_t lanes = hn::Lanes(d);
  size_t i = 0;
  for (; i + lanes <= n; i += lanes) hn::StoreU(f(d, clip(d, hn::LoadU(d, from + i))), d, to + i);
  if (i == n) return;
  HWY_ALIGN float last[HWY_MAX_BYTES / sizeof(float)] = {};
  for (size_t k = 0; i + k < n; ++k) last[k] = from[i + k];
  hn::Store(f(d, clip(d, hn::Load(d, last))), d, last);
  for (size_t k = 0; i + k < n; ++k) to[i + k] = last[k];
}

HWY_ATTR void encode(const float* from, float* to, size_t n, const Tables& tables) {
  map(from, to, n, [&](auto d, auto x) HWY_ATTR { return root(d, x, tables); });
}

HWY_ATTR void network(const float* from, float* to, size_t n, const Tables& tables) {
  map(from, to, n, [&](auto d, auto x) HWY_ATTR {
    const auto v = root(d, x, tables);
    return hn::Sub(hn::Add(v, v), hn::Set(d, 1.0F));
  });
}

HWY_ATTR void levels(const float* from, float* to, size_t n, const Tables& tables) {
  map(from, to, n, [&](auto d, auto x) HWY_ATTR { return hn::ConvertTo(d, level(d, x, tables)); });
}

HWY_ATTR void network_8bit(const float* from, float* to, size_t n, const Tables& tables) {
  map(from, to, n, [&](auto d, auto x) HWY_ATTR {
    return hn::GatherIndex(d, tables.network.data(), level(d, x, tables));
  });
}

}  // namespace HWY_NAMESPACE
}  // namespace opaline::gamma
HWY_AFTER_NAMESPACE();

#if HWY_ONCE
namespace opaline {
namespace gamma {
HWY_EXPORT(encode);
HWY_EXPORT(network);
HWY_EXPORT(levels);
HWY_EXPORT(network_8bit);
}  // namespace gamma

void encode_gamma(std::span<const float> linear, float* encoded) {
  using namespace gamma;
  HWY_DYNAMIC_DISPATCH(encode)(linear.data(), encoded, linear.size(), tables());
}

void encode_network(std::span<const float> linear, float* encoded) {
  using namespace gamma;
  HWY_DYNAMIC_DISPATCH(network)(linear.data(), encoded, linear.size(), tables());
}

void encode_8bit(std::span<const float> linear, float* level) {
  using namespace gamma;
  HWY_DYNAMIC_DISPATCH(levels)(linear.data(), level, linear.size(), tables());
}

void encode_network_8bit(std::span<const float> linear, float* encoded) {
  using namespace gamma;
  HWY_DYNAMIC_DISPATCH(network_8bit)(linear.data(), encoded, linear.size(), tables());
}

float decode_8bit(uint8_t level) {
  return gamma::tables().light[level];
}

}  // namespace opaline
#endif
