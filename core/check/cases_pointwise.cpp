// Activations and other functions of one tensor, and elementwise arithmetic of two.
#include <fmt/format.h>

#include <limits>

#include "core/check/op_case.h"
#include "core/check/reference.h"
#include "core/ops/activation.h"
#include "core/ops/arithmetic.h"
#include "core/ops/unary.h"

namespace opaline::check {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();
const Shape kShape{2, 3, 4, 5};

OpCase unary_case(const std::string& name, Tensor (*f)(const Tensor&), double (*reference)(double),
                  Fill fill = fill::normal(), Shape shape = kShape) {
  return {.name = name,
          .inputs = {{.name = "x", .shape = std::move(shape), .fill = std::move(fill)}},
          .forward = [f](std::span<const Tensor> in) { return f(in[0]); },
          .reference = [reference](std::span<const Array> in) { return reference::map(in[0], reference); }};
}

OpCase rough(OpCase op_case) {
  op_case.smooth = false;
  return op_case;
}

OpCase leaky_relu_case(const std::string& variant, double slope, Fill fill) {
  return {.name = "leaky_relu/" + variant,
          .inputs = {{.name = "x", .shape = kShape, .fill = std::move(fill)}},
          .forward = [slope](std::span<const Tensor> in) { return leaky_relu(in[0], slope); },
          .reference =
              [slope](std::span<const Array> in) {
                return reference::map(in[0], [slope](double v) { return reference::leaky_relu(v, slope); });
              },
          .options = {{"slope", fmt::format("{}", slope)}}};
}

OpCase softmax_case(const std::string& variant, Shape shape, Fill fill = fill::normal()) {
  return {.name = "softmax/" + variant,
          .inputs = {{.name = "x", .shape = std::move(shape), .fill = std::move(fill)}},
          .forward = [](std::span<const Tensor> in) { return softmax(in[0]); },
          .reference = [](std::span<const Array> in) { return reference::softmax(in[0]); }};
}

OpCase clamp_case(const std::string& variant, double low, double high, Fill fill) {
  return {.name = "clamp/" + variant,
          .inputs = {{.name = "x", .shape = kShape, .fill = std::move(fill)}},
          .forward = [low, high](std::span<const Tensor> in) { return clamp(in[0], low, high); },
          .reference =
              [low, high](std::span<const Array> in) {
                return reference::map(in[0], [=](double v) { return reference::clamp(v, low, high); });
              },
          .options = {{"low", fmt::format("{}", low)}, {"high", fmt::format("{}", high)}}};
}

OpCase normalize_case(const std::string& variant, Shape shape, double eps = 1e-12,
                      Fill fill = fill::normal()) {
  return {.name = "normalize/" + variant,
          .inputs = {{.name = "x", .shape = std::move(shape), .fill = std::move(fill)}},
          .forward = [eps](std::span<const Tensor> in) { return normalize(in[0], eps); },
          .reference = [eps](std::span<const Array> in) { return reference::normalize(in[0], eps); },
          .options = {{"eps", fmt::format("{}", eps)}}};
}

OpCase binary_case(const std::string& name, Tensor (*f)(const Tensor&, const Tensor&),
                   double (*reference)(double, double), Shape a, Shape b, Fill fill_b = fill::normal()) {
  return {
      .name = name,
      .inputs = {{.name = "a", .shape = std::move(a)},
                 {.name = "b", .shape = std::move(b), .fill = std::move(fill_b)}},
      .forward = [f](std::span<const Tensor> in) { return f(in[0], in[1]); },
      .reference =
          [reference](std::span<const Array> in) { return reference::broadcast(in[0], in[1], reference); }};
}

OpCase affine_case(const std::string& variant, double scale, double offset) {
  return {.name = "affine/" + variant,
          .inputs = {{.name = "a", .shape = kShape}},
          .forward = [=](std::span<const Tensor> in) { return affine(in[0], scale, offset); },
          .reference =
              [=](std::span<const Array> in) {
                return reference::map(in[0], [=](double v) { return scale * v + offset; });
              },
          .options = {{"scale", fmt::format("{}", scale)}, {"offset", fmt::format("{}", offset)}}};
}

double plus(double a, double b) {
  return a + b;
}
double minus(double a, double b) {
  return a - b;
}
double times(double a, double b) {
  return a * b;
}
double over(double a, double b) {
  return a / b;
}

/// The ways in which two shapes broadcast, for one operation.
void add_binary_cases(std::vector<OpCase>& cases, const std::string& operation,
                      Tensor (*f)(const Tensor&, const Tensor&), double (*reference)(double, double),
                      const Fill& fill_b) {
  const auto add = [&](const std::string& variant, Shape a, Shape b) {
    cases.push_back(binary_case(operation + "/" + variant, f, reference, std::move(a), std::move(b), fill_b));
  };
  add("same", {2, 3, 5}, {2, 3, 5});
  add("channels", {2, 3, 4, 5}, {5});
  add("pixels", {2, 3, 4, 5}, {2, 3, 4, 1});
  add("scalar", {3, 4}, {});
  add("scalar_first", {}, {3, 4});
  add("both", {3, 1, 4}, {2, 1});
  add("empty", {0, 3}, {3});
  OpCase special = binary_case(operation + "/non_finite", f, reference, {7}, {7},
                               fill::values({1.0, 0.0, kNan, 0.0, kInfinity, 2.0, kInfinity}));
  special.inputs[0].fill = fill::values({kNan, 1.0, 1.0, 0.0, kInfinity, kInfinity, -1.0});
  cases.push_back(rough(std::move(special)));
}

}  // namespace

std::vector<OpCase> activation_cases() {
  const Fill kinked = fill::away_from({0.0});
  const Fill special = fill::values({kNan, kInfinity, -kInfinity, 0.0, -0.5, 1.5});
  const Fill large = fill::values({-1e4, -90.0, -40.0, -20.0, 0.5, 20.0, 40.0, 90.0, 1e4});
  return {
      unary_case("relu/plain", relu, reference::relu, kinked),
      unary_case("relu/scalar", relu, reference::relu, kinked, {}),
      rough(unary_case("relu/non_finite", relu, reference::relu, special)),
      leaky_relu_case("plain", 0.01, kinked),
      leaky_relu_case("slope", 0.2, kinked),
      rough(leaky_relu_case("non_finite", 0.1, special)),
      unary_case("gelu/plain", gelu, reference::gelu, fill::normal(2.0)),
      rough(unary_case("gelu/large", gelu, reference::gelu, large)),
      rough(unary_case("gelu/nan", gelu, reference::gelu, fill::values({kNan, 1.0, 0.0}))),
      unary_case("tanh/plain", tanh, reference::tanh),
      rough(unary_case("tanh/large", tanh, reference::tanh, large)),
      rough(unary_case("tanh/non_finite", tanh, reference::tanh, special)),
      unary_case("sigmoid/plain", sigmoid, reference::sigmoid, fill::normal(2.0)),
      rough(unary_case("sigmoid/large", sigmoid, reference::sigmoid, large)),
      rough(unary_case("sigmoid/non_finite", sigmoid, reference::sigmoid, special)),
      softmax_case("rows", {4, 7}),
      softmax_case("attention", {2, 3, 4, 19}),
      softmax_case("vector", {5}),
      rough(softmax_case("one_column", {3, 1})),
      rough(
          softmax_case("large", {3, 4},
                       fill::values({1e3, -1e3, 0.0, 999.0, 1e4, 1e4, -1e4, 0.0, 88.0, 89.0, 90.0, -90.0}))),
      rough(softmax_case("non_finite", {5, 3},
                         fill::values({kNan, 0.0, 1.0, 1.0, kNan, 0.0, kInfinity, 0.0, 1.0, -kInfinity, 0.5,
                                       1.0, 2.0, 1.0, 0.0}))),
  };
}

std::vector<OpCase> unary_cases() {
  const Fill special = fill::values({kNan, kInfinity, -kInfinity, 0.0, -0.5, 1.5});
  return {
      unary_case(
          "abs/plain", abs, [](double v) { return v < 0.0 ? -v : v; }, fill::away_from({0.0})),
      rough(unary_case(
          "abs/non_finite", abs, [](double v) { return v < 0.0 ? -v : v; }, special)),
      unary_case("square/plain", square, [](double v) { return v * v; }),
      rough(unary_case(
          "square/non_finite", square, [](double v) { return v * v; }, special)),
      unary_case("safe_sqrt/positive", safe_sqrt, reference::safe_sqrt, fill::uniform(0.1, 4.0)),
      rough(unary_case("safe_sqrt/zeros", safe_sqrt, reference::safe_sqrt,
                       fill::values({0.0, -0.0, -1.0, 1.0, 1e-30, -1e-30}))),
      rough(unary_case("safe_sqrt/non_finite", safe_sqrt, reference::safe_sqrt, special)),
      clamp_case("plain", -0.5, 0.75, fill::away_from({-0.5, 0.75}, 0.05)),
      rough(clamp_case("ends", -0.5, 0.75, fill::values({-0.5, 0.75, -0.6, 0.8, 0.0}))),
      rough(clamp_case("non_finite", -0.5, 0.75, special)),
      normalize_case("normals", {2, 3, 4, 3}),
      normalize_case("wide", {3, 17}),
      normalize_case("vector", {4}),
      normalize_case("below_eps", {4, 3}, 10.0),
      rough(normalize_case("zero", {3, 3}, 1e-12,
                           fill::values({0.0, 0.0, 0.0, 3.0, 0.0, 4.0, 1e-20, 0.0, 0.0}))),
      rough(normalize_case("nan", {2, 3}, 1e-12, fill::values({kNan, 1.0, 2.0, 1.0, 2.0, 2.0}))),
  };
}

std::vector<OpCase> arithmetic_cases() {
  std::vector<OpCase> cases;
  add_binary_cases(cases, "add", add, plus, fill::normal());
  add_binary_cases(cases, "sub", sub, minus, fill::normal());
  add_binary_cases(cases, "mul", mul, times, fill::normal());
  add_binary_cases(cases, "div", div, over, fill::away_from({0.0}, 0.5));
  cases.push_back(affine_case("plain", 2.0, -1.0));
  cases.push_back(affine_case("zero", 0.0, 0.5));
  return cases;
}

std::vector<OpCase> large_pointwise_cases(int64_t side) {
  const Shape image{1, side, side, 64};
  return {
      unary_case("relu/64", relu, reference::relu, fill::normal(), image),
      unary_case("gelu/tokens", gelu, reference::gelu, fill::normal(), {side, 2048}),
      unary_case("tanh/64", tanh, reference::tanh, fill::normal(), image),
      softmax_case("attention", {8, side, side}),
      binary_case("add/64", add, plus, image, image),
      binary_case("mul/channels", mul, times, image, {64}),
      normalize_case("normals", {1, side, side, 3}),
  };
}

}  // namespace opaline::check
