#include "core/kernels/conv.h"

#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <cstring>
#include <vector>

#include "core/kernels/direct.h"
#include "core/kernels/winograd.h"
#include "core/parallel.h"
#include "core/random.h"
#include "core/tensor.h"

namespace opaline::kernels {
namespace {

constexpr int kDirect = 0;

/// Normal numbers, the same for float and double but for rounding.
template <class T>
std::vector<T> numbers(int64_t count, uint32_t sample) {
  std::vector<T> result(static_cast<size_t>(count));
  Random random(7, Purpose::kTest, 0, sample);
  for (T& value : result) value = static_cast<T>(static_cast<float>(random.normal()));
  return result;
}

template <class T>
struct Passes {
  std::vector<T> y, dx, dweight;
};

/// The three passes over the same numbers by one algorithm; every result starts as NaN, so that a value that
/// is not written shows.
template <class T>
Passes<T> run(const ConvShape& s, int outputs) {
  const int64_t border = s.reflect ? s.padding : 0;
  const auto x = numbers<T>(s.n * s.h * s.w * s.in, 1);
  const auto weight = numbers<T>(s.out * s.in * s.kernel_h * s.kernel_w, 2);
  const auto dy = numbers<T>(s.n * s.out_h() * s.out_w() * s.out, 3);
  const auto bias = numbers<T>(s.out, 4);
  const auto nan = [](int64_t count) {
    return std::vector<T>(static_cast<size_t>(count), std::numeric_limits<T>::quiet_NaN());
  };
  Passes<T> p{nan(s.n * s.out_h() * s.out_w() * s.out),
              nan(s.n * (s.h + 2 * border) * (s.w + 2 * border) * s.in),
              nan(static_cast<int64_t>(weight.size()))};
  const T* const none = nullptr;
  if (outputs == kDirect) {
    direct_forward(s, x.data(), weight.data(), bias.data(), p.y.data());
    direct_input_gradient(s, dy.data(), weight.data(), none, p.dx.data());
    direct_weight_gradient(s, x.data(), dy.data(), p.dweight.data());
  } else {
    const Part<const T> in{x.data(), s.in};
    const Part<T> gradient{p.dx.data(), s.in};
    winograd_forward<T>(outputs, s, {&in, 1}, weight.data(), bias.data(), p.y.data());
    winograd_input_gradient<T>(outputs, s, dy.data(), weight.data(), none, {&gradient, 1});
    winograd_weight_gradient<T>(outputs, s, {&in, 1}, dy.data(), p.dweight.data());
  }
  return p;
}

/// Root mean square of the difference, relative to that of the reference; NaN where a value is.
template <class T>
double error(const std::vector<T>& value, const std::vector<double>& reference) {
  REQUIRE(value.size() == reference.size());
  double difference = 0.0, size = 0.0;
  for (size_t i = 0; i < value.size(); ++i) {
    difference += std::pow(static_cast<double>(value[i]) - reference[i], 2);
    size += reference[i] * reference[i];
  }
  return std::sqrt(difference / size);
}

/// The registry of operations holds the direct algorithm against the definition; this holds the others
/// against it.
std::vector<ConvShape> shapes() {
  const auto shape = [](int64_t n, int64_t h, int64_t w, int64_t in, int64_t out, int64_t padding,
                        bool reflect = false, int64_t kernel = 3) {
    return ConvShape{.n = n,
                     .h = h,
                     .w = w,
                     .in = in,
                     .out = out,
                     .kernel_h = kernel,
                     .kernel_w = kernel,
                     .padding = padding,
                     .reflect = reflect};
  };
  return {
      shape(1, 8, 8, 16, 16, 1),          // whole tiles and lanes
      shape(2, 7, 9, 16, 32, 1),          // tiles that hang over
      shape(1, 5, 6, 3, 2, 1),            // fewer channels than lanes
      shape(2, 6, 5, 21, 37, 1),          // no multiple of the lanes
      shape(1, 3, 3, 5, 7, 0),            // a single output
      shape(1, 1, 1, 18, 17, 1),          // a single pixel
      shape(1, 4, 13, 9, 8, 2),           // as wide a border as a kernel allows
      shape(2, 8, 7, 20, 19, 1, true),    // mirrored
      shape(1, 5, 4, 8, 16, 2, true),     // mirrored twice
      shape(1, 60, 60, 4, 5, 1),          // more tiles than a block
      shape(1, 70, 66, 24, 24, 1, true),  // more blocks than one group
      shape(1, 36, 36, 160, 136, 1),      // channels enough for shared sums
      shape(2, 9, 10, 40, 300, 1),        // channels enough to go by channels
      shape(2, 7, 8, 290, 38, 1, true),   // the same for the gradient of the input
      shape(1, 9, 10, 280, 264, 1),       // the same in several chains of inputs
      shape(1, 26, 26, 150, 260, 1),      // few tiles of 4 x 4, more of 2 x 2
      shape(1, 182, 184, 104, 104, 1),    // so many tiles that their sums go on in double
      shape(0, 4, 4, 16, 16, 1),          // no image
      // Kernels in four blocks of taps.
      shape(2, 9, 11, 16, 32, 3, false, 7),
      shape(2, 10, 8, 21, 37, 3, true, 7),
      shape(1, 7, 7, 3, 2, 0, false, 7),  // a single output
      shape(1, 1, 1, 5, 18, 3, false, 7),
      shape(2, 60, 61, 26, 19, 3, true, 7),
      shape(1, 9, 8, 18, 5, 4, false, 5),
      shape(2, 6, 9, 17, 270, 2, true, 6),
      shape(1, 8, 12, 8, 8, 7, false, 8),
      shape(0, 4, 4, 16, 16, 3, false, 7),
  };
}

std::string describe(const ConvShape& s) {
  return std::to_string(s.n) + "x" + std::to_string(s.h) + "x" + std::to_string(s.w) + "x" +
         std::to_string(s.in) + " -> " + std::to_string(s.out) + ", kernel " + std::to_string(s.kernel_h) +
         ", padding " + std::to_string(s.padding) + (s.reflect ? ", mirrored" : "");
}

TEST_CASE("Winograd's convolutions agree with the direct one in all passes") {
  for (const ConvShape& s : shapes()) {
    INFO(describe(s));
    const Passes<double> reference = run<double>(s, kDirect);
    for (const int outputs : {2, 3, 4, 6}) {
      if (!winograd_fits(s, outputs)) continue;
      INFO("tiles of " << outputs);
      const Passes<double> wide = run<double>(s, outputs);
      const Passes<float> narrow = run<float>(s, outputs);
      if (s.n == 0) {
        // The gradient of a weight that saw nothing is zero.
        for (const double value : wide.dweight) CHECK(value == 0.0);
        continue;
      }
      CHECK(error(wide.y, reference.y) < 1e-13);
      CHECK(error(wide.dx, reference.dx) < 1e-13);
      CHECK(error(wide.dweight, reference.dweight) < 1e-13);
      const double limit = outputs == 6 ? 3e-5 : 3e-6;
      // A few values are no sample of a root mean square; without fused multiply-adds two were 3.8e-6 off.
      CHECK(error(narrow.y, reference.y) < (narrow.y.size() < 16 ? 3.0 : 1.0) * limit);
      CHECK(error(narrow.dx, reference.dx) < limit);
      CHECK(error(narrow.dweight, reference.dweight) < limit);
    }
  }
}

TEST_CASE("convolutions have the same bits for any number of threads") {
  for (const ConvShape& s : shapes()) {
    INFO(describe(s));
    for (const int outputs : {kDirect, winograd_fits(s, 3) ? 3 : 4}) {
      const auto on = [&](int threads) {
        const ThreadsGuard guard(threads);
        return run<float>(s, outputs);
      };
      const Passes<float> one = on(1);
      for (const int threads : {2, 3}) {
        const Passes<float> more = on(threads);
        const auto same = [](const std::vector<float>& a, const std::vector<float>& b) {
          return a.size() == b.size() &&
                 (a.empty() || std::memcmp(a.data(), b.data(), a.size() * sizeof(float)) == 0);
        };
        CHECK(same(one.y, more.y));
        CHECK(same(one.dx, more.dx));
        CHECK(same(one.dweight, more.dweight));
      }
    }
  }
}

TEST_CASE("the gradient of some of an input's parts is their share of the whole one") {
  const std::vector<int64_t> channels = {4, 5, 3};
  for (const bool reflect : {false, true}) {
    const ConvShape s{.n = 2,
                      .h = 6,
                      .w = 7,
                      .in = 12,
                      .out = 10,
                      .kernel_h = 3,
                      .kernel_w = 3,
                      .padding = 1,
                      .reflect = reflect};
    const int64_t pixels = s.n * s.h * s.w;
    const auto weight = numbers<double>(s.out * s.in * 9, 2);
    const auto dy = numbers<double>(s.n * s.out_h() * s.out_w() * s.out, 3);
    const auto bias = numbers<double>(s.in, 4);
    ConvPlan plan(Numerics::kBalanced);
    std::vector<double> all(static_cast<size_t>(pixels * s.in));
    const Part<double> whole{all.data(), s.in};
    conv_input_gradient<double>(s, plan, dy.data(), weight.data(), bias.data(), {&whole, 1});
    // Every subset of the parts, the empty one too.
    for (unsigned subset = 0; subset < 8; ++subset) {
      std::vector<std::vector<double>> gradients;
      std::vector<Part<double>> parts;
      for (size_t i = 0; i < channels.size(); ++i) {
        gradients.emplace_back(static_cast<size_t>(pixels * channels[i]));
        parts.push_back({(subset >> i & 1U) != 0 ? gradients[i].data() : nullptr, channels[i]});
      }
      conv_input_gradient<double>(s, plan, dy.data(), weight.data(), bias.data(), parts);
      INFO("subset " << subset << ", mirrored " << reflect);
      int64_t first = 0;
      for (size_t i = 0; i < channels.size(); ++i) {
        double worst = 0.0;
        for (int64_t pixel = 0; pixel < pixels && parts[i].data != nullptr; ++pixel) {
          for (int64_t c = 0; c < channels[i]; ++c) {
            const double expected = all[static_cast<size_t>(pixel * s.in + first + c)];
            worst = std::max(worst,
                             std::abs(gradients[i][static_cast<size_t>(pixel * channels[i] + c)] - expected));
          }
        }
        CHECK(worst < 1e-12);
        first += channels[i];
      }
    }
  }
}

TEST_CASE("a number that is none reaches every output of its window") {
  const ConvShape s{
      .n = 1, .h = 9, .w = 9, .in = 16, .out = 16, .kernel_h = 3, .kernel_w = 3, .stride = 1, .padding = 1};
  for (const float bad : {std::numeric_limits<float>::quiet_NaN(), std::numeric_limits<float>::infinity()}) {
    for (const int outputs : {kDirect, 2, 4, 6}) {
      INFO("tiles of " << outputs << ", value " << bad);
      auto x = numbers<float>(9 * 9 * 16, 1);
      const auto weight = numbers<float>(16 * 16 * 9, 2);
      x[(4 * 9 + 5) * 16 + 3] = bad;
      std::vector<float> y(9 * 9 * 16);
      if (outputs == kDirect) {
        direct_forward<float>(s, x.data(), weight.data(), nullptr, y.data());
      } else {
        const Part<const float> in{x.data(), s.in};
        winograd_forward<float>(outputs, s, {&in, 1}, weight.data(), nullptr, y.data());
      }
      for (int row = 3; row <= 5; ++row) {
        for (int column = 4; column <= 6; ++column) {
          for (int c = 0; c < 16; ++c)
            CHECK_FALSE(std::isfinite(y[static_cast<size_t>((row * 9 + column) * 16 + c)]));
        }
      }
    }
  }
}

}  // namespace
}  // namespace opaline::kernels
