// Losses: masks that are partly, wholly or in one image empty, one value a channel, vectors of length zero,
// and values outside the mask that are not numbers.
#include <limits>

#include "core/check/op_case.h"
#include "core/check/reference.h"
#include "core/ops/loss.h"

namespace opaline::check {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

using MaskedLoss = Tensor (*)(const Tensor&, const Tensor&, const Tensor&);
using MaskedReference = Array (*)(const Array&, const Array&, const Array&);

OpCase masked_case(const std::string& name, MaskedLoss f, MaskedReference reference, const Shape& shape,
                   Fill mask = fill::mask()) {
  return {.name = name,
          .inputs = {{.name = "x", .shape = shape},
                     {.name = "target", .shape = shape, .differentiable = false},
                     {.name = "mask",
                      .shape = {shape[0], shape[1], shape[2], 1},
                      .fill = std::move(mask),
                      .differentiable = false}},
          .forward = [f](std::span<const Tensor> in) { return f(in[0], in[1], in[2]); },
          .reference = [reference](std::span<const Array> in) { return reference(in[0], in[1], in[2]); }};
}

OpCase pair_case(const std::string& name, Tensor (*f)(const Tensor&, const Tensor&),
                 Array (*reference)(const Array&, const Array&), const Shape& shape) {
  return {
      .name = name,
      .inputs = {{.name = "x", .shape = shape}, {.name = "target", .shape = shape, .differentiable = false}},
      .forward = [f](std::span<const Tensor> in) { return f(in[0], in[1]); },
      .reference = [reference](std::span<const Array> in) { return reference(in[0], in[1]); }};
}

OpCase rough(OpCase op_case) {
  op_case.smooth = false;
  return op_case;
}

OpCase with_x(OpCase op_case, Fill fill) {
  op_case.inputs[0].fill = std::move(fill);
  return rough(std::move(op_case));
}

void add_masked_cases(std::vector<OpCase>& cases, const std::string& operation, MaskedLoss f,
                      MaskedReference reference) {
  const auto make = [&](const std::string& variant, const Shape& shape, Fill mask = fill::mask()) {
    return masked_case(operation + "/" + variant, f, reference, shape, std::move(mask));
  };
  cases.push_back(make("normal", {2, 4, 5, 3}));
  cases.push_back(make("depth", {3, 4, 4, 1}));
  cases.push_back(make("full", {1, 3, 4, 12}, fill::mask(2.0)));
  cases.push_back(make("one_empty_image", {2, 3, 3, 3}, fill::mask(0.8, 9)));
  cases.push_back(make("empty", {2, 3, 3, 3}, fill::mask(0.0)));
  cases.push_back(make("one_pixel", {1, 1, 1, 3}, fill::mask(2.0)));
  cases.push_back(make("one_value", {5, 1, 1, 1}, fill::mask(2.0)));
  // The first pixel of x is no number: outside the mask nobody looks, inside it surfaces.
  const Fill nan_first = [](std::span<double> values, Random& random) {
    fill::normal()(values, random);
    values[0] = kNan;
  };
  cases.push_back(with_x(make("nan_outside", {1, 3, 3, 3}, fill::mask(0.9, 1)), nan_first));
  cases.push_back(with_x(make("nan_inside", {1, 3, 3, 3}, fill::mask(2.0)), nan_first));
}

}  // namespace

std::vector<OpCase> loss_cases() {
  std::vector<OpCase> cases;
  add_masked_cases(cases, "masked_l1_loss", masked_l1_loss, reference::masked_l1_loss);
  add_masked_cases(cases, "masked_mse_loss", masked_mse_loss, reference::masked_mse_loss);
  add_masked_cases(cases, "cosine_loss", cosine_loss, reference::cosine_loss);
  // The cosine of single values is a sign: no difference quotient could show anything.
  for (OpCase& op_case : cases) {
    if (op_case.operation() == "cosine_loss" && op_case.inputs[0].shape[3] == 1) op_case.smooth = false;
  }
  OpCase zero = masked_case("cosine_loss/zero_vectors", cosine_loss, reference::cosine_loss, {1, 2, 2, 3},
                            fill::mask(2.0));
  zero.inputs[1].fill = fill::values({0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -1.0, 1.0, 0.0, 0.0});
  cases.push_back(
      with_x(std::move(zero), fill::values({0.0, 0.0, 0.0, 1.0, 2.0, 2.0, 0.0, 0.0, 0.0, 1.0, 0.0, 1.0})));
  // Where both are equal the derivative of |x - target| is 0.
  OpCase equal = masked_case("masked_l1_loss/equal", masked_l1_loss, reference::masked_l1_loss, {1, 2, 2, 2},
                             fill::mask(2.0));
  equal.inputs[1].fill = fill::values({1.0, 2.0});
  cases.push_back(with_x(std::move(equal), fill::values({1.0, 3.0, 1.0, 2.0})));
  cases.push_back(pair_case("l1_loss/vectors", l1_loss, reference::l1_loss, {4, 7}));
  cases.push_back(pair_case("l1_loss/one", l1_loss, reference::l1_loss, {1}));
  cases.push_back(pair_case("mse_loss/vectors", mse_loss, reference::mse_loss, {4, 27}));
  cases.push_back(pair_case("mse_loss/one", mse_loss, reference::mse_loss, {1}));
  cases.push_back(
      with_x(pair_case("l1_loss/nan", l1_loss, reference::l1_loss, {3}), fill::values({kNan, 1.0, 2.0})));
  cases.push_back(
      with_x(pair_case("mse_loss/nan", mse_loss, reference::mse_loss, {3}), fill::values({kNan, 1.0, 2.0})));
  return cases;
}

std::vector<OpCase> large_loss_cases(int64_t side) {
  return {
      masked_case("masked_l1_loss/12", masked_l1_loss, reference::masked_l1_loss, {1, side, side, 12},
                  fill::mask(0.3)),
      masked_case("masked_mse_loss/3", masked_mse_loss, reference::masked_mse_loss, {1, side, side, 3},
                  fill::mask(0.3)),
      masked_case("cosine_loss/3", cosine_loss, reference::cosine_loss, {1, side, side, 3}, fill::mask(0.3)),
  };
}

}  // namespace opaline::check
