// The checks themselves: they have to see what is wrong.
#include <catch2/catch.hpp>
#include <cmath>
#include <limits>

#include "core/autograd.h"
#include "core/check/run.h"
#include "core/ops/activation.h"
#include "core/ops/arithmetic.h"
#include "core/ops/unary.h"

namespace opaline::check {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();

Array array(std::vector<double> values) {
  Array result({static_cast<int64_t>(values.size())});
  result.values = std::move(values);
  return result;
}

TEST_CASE("relative errors") {
  CHECK(relative_error(array({1, 2}), array({1, 4})) == 0.5);
  CHECK(relative_error(array({0, 1e-3}), array({0, 0})) == 1e-3);
  CHECK(relative_error(array({1, 2}), array({1, 4}), 8.0) == 0.25);
  CHECK(relative_error(array({1}), array({1, 1})) == kInfinity);
  CHECK(relative_error(array({kNan, 1}), array({2, 1})) == kInfinity);
  CHECK(relative_error(array({kInfinity, 1}), array({2, 1})) == kInfinity);
  CHECK(relative_error(array({2, 1}), array({kNan, 1})) == kInfinity);
  CHECK(relative_error(array({2, 1}), array({kInfinity, 1})) == kInfinity);
  CHECK(relative_error(array({-kInfinity, 1}), array({kInfinity, 1})) == kInfinity);
  CHECK(relative_error(array({kNan, kInfinity, 1}), array({kNan, kInfinity, 1})) == 0.0);
}

/// square, whose gradient is `factor` times too large, or wrong in one element alone.
Tensor wrong_square(const Tensor& x, double factor, int64_t element) {
  const Tensor y = square(x.detach());
  if (!should_record({&x})) return y;
  return record("wrong_square", y, {x}, [=, x = x.detach()](const Tensor& dy, std::span<const char>) {
    Tensor dx = affine(mul(dy, x), 2.0);
    for (int64_t i = 0; i < dx.numel(); ++i) {
      if (element < 0 || element == i) dx.data<double>()[i] *= factor;
    }
    return std::vector<Tensor>{dx};
  });
}

double worst_error(double factor, int64_t element) {
  const OpCase op_case{
      .name = "square/wrong",
      .inputs = {{.name = "x", .shape = {5, 20}}},
      .forward = [=](std::span<const Tensor> in) { return wrong_square(in[0], factor, element); },
      .reference = [](std::span<const Array> in) { return in[0]; }};
  return gradient_errors(op_case).at(0).error;
}

TEST_CASE("the gradient check sees a wrong gradient") {
  CHECK(worst_error(1.0, -1) < 1e-7);
  CHECK(worst_error(1.0 + 1e-5, -1) > 3e-6);
  CHECK(worst_error(1.01, 57) > 1e-5);  // one element of a hundred
  CHECK(worst_error(-1.0, -1) > 1.0);
  CHECK(std::isnan(worst_error(kNan, 3)));
}

TEST_CASE("a probe across a kink is drawn again, and one at a kink fails") {
  const auto check = [](const Fill& fill) {
    const OpCase op_case{.name = "relu/kinks",
                         .inputs = {{.name = "x", .shape = {40}, .fill = fill}},
                         .forward = [](std::span<const Tensor> in) { return relu(in[0]); },
                         .reference = [](std::span<const Array> in) { return in[0]; }};
    return gradient_errors(op_case).at(0);
  };
  // 1e-6 is nearer to the kink than the first step is long.
  const GradientError near = check(fill::values({1e-6, 1.0, -1.0}));
  CHECK(near.redrawn > 0);
  CHECK(near.error < 1e-6);
  // At the kink itself every step sees half a slope.
  CHECK(!(check(fill::values({0.0})).error <= 1e-1));
}

TEST_CASE("the comparison with a reference sees a wrong value") {
  OpCase op_case{.name = "square/value",
                 .inputs = {{.name = "x", .shape = {4}}},
                 .forward = [](std::span<const Tensor> in) { return square(in[0]); },
                 .reference =
                     [](std::span<const Array> in) {
                       Array y = in[0];
                       for (double& v : y.values) v *= v;
                       return y;
                     }};
  const CaseRun run = run_case(op_case, DType::kFloat64);
  CHECK(reference_error(op_case, run) == 0.0);
  op_case.reference = [](std::span<const Array> in) { return in[0]; };
  CHECK(reference_error(op_case, run) > 1e-3);
}

TEST_CASE("golden values that are missing or differ are seen") {
  const OpCase op_case{.name = "square/golden",
                       .inputs = {{.name = "x", .shape = {300}}},
                       .forward = [](std::span<const Tensor> in) { return square(in[0]); },
                       .reference = [](std::span<const Array> in) { return in[0]; }};
  const CaseRun run = run_case(op_case, DType::kFloat64);
  CHECK_THROWS_WITH(golden_error(op_case, run, {}),
                    Catch::Contains("square/golden") && Catch::Contains("ops.py"));
  // Over 256 values: a sample and the norm.
  TensorMap golden;
  for (const auto& [name, tensor] : {std::pair{"golden/y", run.y}, {"golden/grad.x", run.gradients[0]}}) {
    std::vector<double> sample;
    double squares = 0.0;
    for (int64_t i = 0; i < tensor.numel(); ++i) {
      if (i % 37 == 0) sample.push_back(tensor.at(i));
      squares += tensor.at(i) * tensor.at(i);
    }
    golden[std::string(name) + ".sample"] =
        Tensor::from(std::span<const double>(sample), {static_cast<int64_t>(sample.size())});
    golden[std::string(name) + ".norm"] = Tensor::scalar(std::sqrt(squares), DType::kFloat64);
  }
  CHECK(golden_error(op_case, run, golden) < 1e-15);
  run.gradients[0].detach().data<double>()[100] += 1e-3;  // in no sample
  CHECK(golden_error(op_case, run, golden) > 1e-9);
}

}  // namespace
}  // namespace opaline::check
