// Normalisations.
#include <fmt/format.h>

#include <limits>

#include "core/check/op_case.h"
#include "core/check/reference.h"
#include "core/ops/norm.h"

namespace opaline::check {
namespace {

const Fill kWeight = fill::normal(0.3, 1.0);
const Fill kBias = fill::normal(0.3);
const Fill kVariance = fill::uniform(0.5, 2.0);

OpCase layer_norm_case(const std::string& variant, const Shape& shape, double eps = 1e-5,
                       Fill fill = fill::normal()) {
  return {.name = "layer_norm/" + variant,
          .inputs = {{.name = "x", .shape = shape, .fill = std::move(fill)},
                     {.name = "weight", .shape = {shape.back()}, .fill = kWeight},
                     {.name = "bias", .shape = {shape.back()}, .fill = kBias}},
          .forward = [eps](std::span<const Tensor> in) { return layer_norm(in[0], in[1], in[2], eps); },
          .reference =
              [eps](std::span<const Array> in) { return reference::layer_norm(in[0], in[1], in[2], eps); },
          .options = {{"eps", fmt::format("{}", eps)}}};
}

struct BatchNormCase {
  bool training = true;
  bool tracked = true;
  double momentum = 0.1;
  Fill fill = fill::normal();
  bool relu = false;
};

/// The positive part, where the operation takes it too.
Array rectified(Array y, bool relu) {
  for (double& value : y.values) value = relu ? reference::relu(value) : value;
  return y;
}

OpCase batch_norm_case(const std::string& variant, const Shape& shape, const BatchNormCase& c = {}) {
  const Shape channels{shape.back()};
  OpCase result{.name = "batch_norm/" + variant,
                .inputs = {{.name = "x", .shape = shape, .fill = c.fill},
                           {.name = "weight", .shape = channels, .fill = kWeight},
                           {.name = "bias", .shape = channels, .fill = kBias}},
                .forward =
                    [c](std::span<const Tensor> in) {
                      return batch_norm(in[0], in[1], in[2], c.tracked ? in[3] : Tensor(),
                                        c.tracked ? in[4] : Tensor(),
                                        {.training = c.training, .momentum = c.momentum, .relu = c.relu});
                    },
                .reference = [c](std::span<const Array> in) -> ReferenceResult {
                  const Array none{Shape{0}};
                  auto r = reference::batch_norm(in[0], in[1], in[2], c.tracked ? in[3] : none,
                                                 c.tracked ? in[4] : none, c.training, c.momentum, 1e-5);
                  r.y = rectified(std::move(r.y), c.relu);
                  if (!c.tracked) return {std::move(r.y)};
                  return {std::move(r.y), {std::move(r.running_mean), std::move(r.running_var)}};
                },
                .options = {{"training", fmt::format("{}", c.training)},
                            {"momentum", fmt::format("{}", c.momentum)},
                            {"relu", fmt::format("{}", c.relu)}}};
  if (c.tracked) {
    result.inputs.push_back(
        {.name = "running_mean", .shape = channels, .fill = kBias, .differentiable = false, .updated = true});
    result.inputs.push_back({.name = "running_var",
                             .shape = channels,
                             .fill = kVariance,
                             .differentiable = false,
                             .updated = true});
  }
  return result;
}

OpCase instance_norm_case(const std::string& variant, const Shape& shape, bool affine,
                          Fill fill = fill::normal(), bool relu = false) {
  OpCase result{
      .name = "instance_norm/" + variant,
      .inputs = {{.name = "x", .shape = shape, .fill = std::move(fill)}},
      .forward =
          [affine, relu](std::span<const Tensor> in) {
            return instance_norm(in[0], affine ? in[1] : Tensor(), affine ? in[2] : Tensor(), {.relu = relu});
          },
      .reference =
          [affine, relu](std::span<const Array> in) {
            return rectified(affine ? reference::instance_norm(in[0], in[1], in[2], 1e-5)
                                    : reference::instance_norm(in[0], std::nullopt, std::nullopt, 1e-5),
                             relu);
          },
      .options = {{"relu", fmt::format("{}", relu)}}};
  if (affine) {
    result.inputs.push_back({.name = "weight", .shape = {shape[3]}, .fill = kWeight});
    result.inputs.push_back({.name = "bias", .shape = {shape[3]}, .fill = kBias});
  }
  return result;
}

Fill with_nan_at(size_t position) {
  return [position](std::span<double> values, Random& random) {
    fill::normal()(values, random);
    values[position] = std::numeric_limits<double>::quiet_NaN();
  };
}

OpCase rough(OpCase op_case) {
  op_case.smooth = false;
  return op_case;
}

/// Two values always become -1 and 1, nearly, and a single one 0: the gradient is what eps leaves of terms
/// that cancel and that the division by sqrt(eps) has made large.
OpCase cancelling(OpCase op_case) {
  op_case.tolerances.float32_gradient = 5e-2;
  op_case.tolerances.golden = 1e-9;
  return op_case;
}

/// A mean far over the spread costs digits: in float32 those that the input itself has lost.
OpCase offset(OpCase op_case) {
  op_case.tolerances = {.float64 = 1e-10, .float32 = 1e-4, .float32_gradient = 1e-3, .golden = 1e-9};
  return op_case;
}

}  // namespace

std::vector<OpCase> norm_cases() {
  return {
      layer_norm_case("rows", {5, 8}),
      layer_norm_case("tokens", {2, 3, 33}, 1e-6),
      layer_norm_case("two", {4, 2}),
      layer_norm_case("four_dimensions", {2, 2, 3, 5}),
      // One value a row, and rows of equal values: the variance is zero and the result the bias.
      cancelling(rough(layer_norm_case("one", {3, 1}))),
      rough(layer_norm_case("constant", {2, 4}, 1e-5, fill::values({3.0}))),
      offset(layer_norm_case("offset", {3, 16}, 1e-5, fill::normal(1.0, 1000.0))),
      rough(layer_norm_case("nan", {3, 5}, 1e-5, with_nan_at(7))),

      batch_norm_case("2d_train", {2, 4, 5, 3}),
      batch_norm_case("2d_train_lanes", {2, 3, 3, 16}),
      batch_norm_case("2d_train_off_lanes", {1, 4, 4, 19}),
      batch_norm_case("2d_train_momentum", {2, 3, 3, 5}, {.momentum = 0.5}),
      batch_norm_case("2d_train_untracked", {2, 3, 4, 5}, {.tracked = false}),
      batch_norm_case("2d_eval", {2, 4, 5, 3}, {.training = false}),
      batch_norm_case("2d_many_rows", {2, 24, 25, 2}),
      batch_norm_case("2d_train_relu", {2, 4, 5, 19}, {.relu = true}),
      batch_norm_case("2d_eval_relu", {2, 4, 5, 3}, {.training = false, .relu = true}),
      batch_norm_case("1d_train", {8, 27}),
      batch_norm_case("1d_train_two", {2, 5}),
      batch_norm_case("1d_eval", {4, 7}, {.training = false}),
      batch_norm_case("1d_eval_one", {1, 7}, {.training = false}),
      rough(batch_norm_case("1d_train_one", {1, 6})),
      rough(batch_norm_case("2d_constant", {2, 3, 3, 2}, {.fill = fill::values({2.0, -1.0})})),
      offset(batch_norm_case("2d_offset", {2, 5, 5, 4}, {.fill = fill::normal(1.0, 1000.0)})),
      rough(batch_norm_case("2d_nan_relu", {2, 3, 3, 4}, {.fill = with_nan_at(18), .relu = true})),
      rough(batch_norm_case("2d_nan", {2, 3, 3, 4}, {.fill = with_nan_at(18)})),

      instance_norm_case("plain", {2, 4, 5, 3}, false),
      instance_norm_case("affine", {2, 4, 5, 3}, true),
      instance_norm_case("plain_lanes", {1, 3, 4, 32}, false),
      instance_norm_case("affine_off_lanes", {2, 3, 3, 17}, true),
      instance_norm_case("affine_relu", {2, 4, 5, 3}, true, fill::normal(), true),
      cancelling(instance_norm_case("two_pixels", {3, 1, 2, 4}, false)),
      cancelling(rough(instance_norm_case("one_pixel", {2, 1, 1, 3}, true))),
      offset(instance_norm_case("offset", {2, 5, 5, 3}, false, fill::normal(1.0, 1000.0))),
      rough(instance_norm_case("nan", {2, 3, 3, 4}, false, with_nan_at(18))),
  };
}

std::vector<OpCase> large_norm_cases(int64_t side) {
  return {
      layer_norm_case("tokens_512", {side, 512}, 1e-6),
      batch_norm_case("train_64", {1, side, side, 64}),
      batch_norm_case("eval_64", {1, side, side, 64}, {.training = false}),
      instance_norm_case("128", {1, side / 2, side / 2, 128}, false),
  };
}

}  // namespace opaline::check
