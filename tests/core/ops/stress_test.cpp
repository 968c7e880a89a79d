// Every operation on inputs that float32 finds hard (core/check/stress.h), against float64.
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <map>
#include <set>
#include <string>

#include "core/check/stress.h"
#include "core/parallel.h"

namespace opaline::check {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();

struct Bound {
  double forward, backward;
};

// A few roundings of 6e-8; what is not here has kUsual. 0: every bit is exact.
constexpr Bound kUsual{2e-7, 3e-7};
const std::map<std::string, Bound>& bounds() {
  static const std::map<std::string, Bound> table = {
      {"conv2d", {4e-6, 3e-6}},  // sums of up to 315 equal terms
      {"conv_transpose2d", {8e-7, 3e-6}},
      {"linear", {6e-7, 6e-7}},
      {"matmul", {8e-7, 6e-7}},
      {"scaled_dot_product_attention", {6e-7, 6e-7}},
      {"gelu", {4e-7, 4e-7}},  // the fit of erfc has 1.2e-7
      {"batch_norm", {4e-7, 3e-7}},
      {"div", {1e-7, 2e-6}},  // sums of denormal quotients
      {"upsample_bilinear", {3e-7, 5e-7}},
      {"relu", {0, 0}},
      {"abs", {0, 0}},
      {"clamp", {0, 0}},
      {"max_pool2d", {0, 0}},
      {"concat", {0, 0}},
      {"reshape", {0, 0}},
      {"permute", {0, 0}},
      {"slice", {0, 0}},
      {"to_nhwc", {0, 0}},
      {"to_nchw", {0, 0}},
  };
  return table;
}

/// Winograd's algorithm scales its intermediate numbers down: denormal ones lose digits.
Bound bound_of(const OpCase& op_case, Numerics numerics) {
  const auto found = bounds().find(std::string(op_case.operation()));
  const Bound bound = found == bounds().end() ? kUsual : found->second;
  if (op_case.operation() != "conv2d" || numerics == Numerics::kStrict) return bound;
  return op_case.name.ends_with("denormal") ? Bound{1e-5, 1e-4} : Bound{1e-5, 1e-5};
}

TEST_CASE("operations keep their digits under stress") {
  const ThreadsGuard one_thread(1);
  std::map<std::string, std::set<std::string>> lost;
  for (const OpCase& op_case : op_cases()) {
    if (!op_case.in_pytorch) continue;
    for (const Regime& regime : stress_regimes()) {
      const StressCase stress(op_case, regime);
      for (const Numerics numerics : {Numerics::kStrict, Numerics::kBalanced, Numerics::kFast}) {
        const StressErrors errors = stress.run(numerics);
        const Bound bound = bound_of(stress.op_case(), numerics);
        INFO(stress.op_case().name << ", " << to_string(numerics) << ": " << errors.forward.value << ", "
                                   << errors.backward.value);
        CHECK(errors.forward.value <= bound.forward);
        CHECK(errors.backward.value <= bound.backward);
        CHECK_FALSE(errors.forward.lost);
        if (errors.backward.lost) lost[std::string(op_case.operation())].insert(stress.op_case().name);
      }
    }
  }
  // a / b / b is infinite before dy makes it small; PyTorch loses the same two.
  CHECK(lost == std::map<std::string, std::set<std::string>>{
                    {"div", {"div/same@all_denormal", "div/scalar_first@all_denormal"}}});
}

TEST_CASE("every operation meets every regime") {
  const ThreadsGuard one_thread(1);
  std::map<std::string, int64_t> expected, found;
  for (const OpCase& op_case : op_cases()) {
    if (!op_case.in_pytorch) continue;
    expected[std::string(op_case.operation())] += static_cast<int64_t>(stress_regimes().size());
  }
  for (const StressSummary& summary : run_stress(Numerics::kBalanced)) {
    found[summary.operation] = summary.cases;
  }
  CHECK(found == expected);
  for (const auto& [operation, bound] : bounds()) {
    INFO(operation);
    CHECK(expected.contains(operation));
  }
}

Array array(std::vector<double> values) {
  Array result({static_cast<int64_t>(values.size())});
  result.values = std::move(values);
  return result;
}

TEST_CASE("an operation that nothing says how to measure is refused") {
  OpCase unknown = op_cases().front();
  unknown.name = "nothing/plain";
  CHECK_THROWS_WITH(StressCase(unknown, stress_regimes().front()), Catch::Contains("[nothing]"));
}

const Regime& regime_called(const std::string& name) {
  return *std::ranges::find(stress_regimes(), name, &Regime::name);
}

TEST_CASE("regimes are what they are called") {
  const OpCase& plain = *std::ranges::find(op_cases(), "mul/same", &OpCase::name);
  const auto values = [&](const std::string& name, size_t input = 0) {
    return Array(make_inputs(stressed(plain, regime_called(name)), DType::kFloat32)[input]).values;
  };
  const auto count = [&](const std::string& name, const std::function<bool(double)>& is) {
    return std::ranges::count_if(values(name), is);
  };
  const auto all = static_cast<std::ptrdiff_t>(values("normal").size());
  constexpr double kSmallest = std::numeric_limits<float>::min();
  CHECK(count("nan", [](double v) { return std::isnan(v); }) == 1);
  CHECK(count("infinity", [](double v) { return v == kInfinity; }) == 1);
  CHECK(count("minus_infinity", [](double v) { return v == -kInfinity; }) == 1);
  CHECK(count("denormal", [](double v) { return std::abs(v) < kSmallest; }) == all);
  CHECK(count("denormal", [](double v) { return v != 0.0; }) > all / 2);
  CHECK(count("zeros", [](double v) { return v == 0.0 && std::signbit(v); }) > 0);
  CHECK(count("zeros", [](double v) { return v == 0.0 && !std::signbit(v); }) > 0);
  CHECK(count("offset", [](double v) { return std::abs(v - 1e4) < 10.0; }) == all);
  CHECK(count("wide", [](double v) { return std::abs(v) < 1e-15; }) > 0);
  CHECK(count("wide", [](double v) { return std::abs(v) > 1e15; }) > 0);
  CHECK(largest_magnitude(array(values("huge"))) > 1e29);
  CHECK(largest_magnitude(array(values("huge_by_tiny", 1))) < 1e-28);
  CHECK(largest_magnitude(Array(
            make_cotangent(stressed(plain, regime_called("gradient_tiny")), {9}, DType::kFloat32))) < 1e-37);
}

double error(const Expected& expected, std::vector<double> actual) {
  const StressError found = expected.error(array(std::move(actual)));
  return found.lost ? -1.0 : found.value;
}

TEST_CASE("errors are relative to their scale, but not to less than the smallest normal number") {
  CHECK(error({array({1, 2}), array({1, 4})}, {1, 3}) == 0.25);
  CHECK(error({array({1, 2}), array({10})}, {1, 3}) == 0.1);
  CHECK(error({array({1e-40}), array({1e-40})}, {0}) == Approx(1e-40 / 1.1754944e-38));
  CHECK(error({array({0}), array({0})}, {1e-30}) > 1e7);
  CHECK(Expected{array({1}), array({1})}.error(array({1, 1})).value == kInfinity);
}

TEST_CASE("what is no number has to surface, and numbers in float32's range have to stay") {
  CHECK(error({array({kNan, 1}), array({kNan, 1})}, {1, 1}) == kInfinity);
  CHECK(error({array({kInfinity, 1}), array({kInfinity, 1})}, {kNan, 1}) == 0.0);
  CHECK(error({array({1, 1}), array({1, 1})}, {kNan, 1}) == -1.0);
  CHECK(error({array({1e38}), array({1e38})}, {kInfinity}) == -1.0);
  CHECK(error({array({1e39}), array({1e39})}, {kInfinity}) == 0.0);
  CHECK(error({array({1e10}), array({1e39})}, {kNan}) == 0.0);  // the terms leave the range, and cancel
  CHECK_FALSE(Expected{array({1, kNan}), array({1})}.error(array({kNan, kNan}), true).lost);
}

/// Errors of a square that is wrong in its own way.
StressErrors errors_of_square(const std::string& regime, const std::function<float(float)>& square) {
  OpCase op_case = *std::ranges::find(op_cases(), "square/plain", &OpCase::name);
  const auto right = op_case.forward;
  op_case.forward = [=](std::span<const Tensor> in) {
    if (in[0].dtype() != DType::kFloat32) return right(in);
    Tensor y(in[0].shape());
    for (int64_t i = 0; i < y.numel(); ++i) y.data<float>()[i] = square(in[0].data<float>()[i]);
    return y;
  };
  return StressCase(op_case, regime_called(regime)).run(Numerics::kStrict);
}

TEST_CASE("the suite sees a wrong operation") {
  CHECK(errors_of_square("normal", [](float x) { return x * x; }).forward.value < 1e-7);
  CHECK(errors_of_square("normal", [](float x) { return x * x * 1.001F; }).forward.value > 1e-4);
  CHECK(errors_of_square("nan", [](float x) { return std::isnan(x) ? 0.0F : x * x; }).forward.value ==
        kInfinity);
  CHECK(errors_of_square("tiny_by_huge", [](float x) { return x * x; }).forward.value < 1e-7);
  CHECK(errors_of_square("wide", [](float x) { return std::abs(x) > 1e15F ? NAN : x * x; }).forward.lost);
}

}  // namespace
}  // namespace opaline::check
