// Convolutions: strides 1 and 2, kernels 1 to 7, both paddings, with and without bias, channel counts on and
// off the multiples of vector lanes.
#include <limits>

#include "core/check/op_case.h"
#include "core/check/reference.h"
#include "core/ops/conv.h"

namespace opaline::check {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();
constexpr double kInfinity = std::numeric_limits<double>::infinity();

struct Geometry {
  Shape x;  ///< N x H x W x I
  int64_t out = 1;
  int64_t kernel_h = 3, kernel_w = 3;
  int64_t stride = 1, padding = 0;
  bool reflect = false;
  bool bias = false;
};

Tensor at_or_none(std::span<const Tensor> in, size_t i) {
  return i < in.size() ? in[i] : Tensor();
}
std::optional<Array> at_or_none(std::span<const Array> in, size_t i) {
  return i < in.size() ? std::optional(in[i]) : std::nullopt;
}

std::map<std::string, std::string> json_options(const Geometry& g) {
  return {{"stride", std::to_string(g.stride)},
          {"padding", std::to_string(g.padding)},
          {"reflect", g.reflect ? "true" : "false"}};
}

OpCase conv2d_case(const std::string& variant, const Geometry& g) {
  const reference::ConvParameters parameters{.stride = g.stride, .padding = g.padding, .reflect = g.reflect};
  OpCase result{.name = "conv2d/" + variant,
                .inputs = {{.name = "x", .shape = g.x},
                           {.name = "weight", .shape = {g.out, g.x[3], g.kernel_h, g.kernel_w}}},
                .forward =
                    [g](std::span<const Tensor> in) {
                      return conv2d(in[0], in[1], at_or_none(in, 2),
                                    {.stride = g.stride,
                                     .padding = g.padding,
                                     .padding_mode = g.reflect ? Padding::kReflect : Padding::kZeros});
                    },
                .reference =
                    [parameters](std::span<const Array> in) {
                      return reference::conv2d(in[0], in[1], at_or_none(in, 2), parameters);
                    },
                .options = json_options(g)};
  if (g.bias) result.inputs.push_back({.name = "bias", .shape = {g.out}});
  return result;
}

/// The same input in two parts, the first of so many channels.
OpCase conv2d_parts_case(const std::string& variant, const Geometry& g, int64_t first) {
  OpCase result = conv2d_case(variant, g);
  Shape x = g.x, other = g.x;
  x[3] = first;
  other[3] = g.x[3] - first;
  result.inputs[0].shape = x;
  result.inputs.insert(result.inputs.begin() + 1, {.name = "other", .shape = other});
  result.forward = [g](std::span<const Tensor> in) {
    return conv2d(in.first(2), in[2], at_or_none(in, 3),
                  {.stride = g.stride,
                   .padding = g.padding,
                   .padding_mode = g.reflect ? Padding::kReflect : Padding::kZeros});
  };
  result.reference = [whole = conv2d_case(variant, g).reference, g, first](std::span<const Array> in) {
    Array joined(g.x);
    for (int64_t i = 0; i < joined.count(); ++i) {
      const int64_t pixel = i / g.x[3], c = i % g.x[3];
      joined[i] = c < first ? in[0][pixel * first + c] : in[1][pixel * (g.x[3] - first) + c - first];
    }
    std::vector<Array> inputs{joined};
    inputs.insert(inputs.end(), in.begin() + 2, in.end());
    return whole(inputs);
  };
  return result;
}

OpCase conv_transpose2d_case(const std::string& variant, const Geometry& g) {
  const reference::ConvParameters parameters{.stride = g.stride, .padding = g.padding};
  OpCase result{.name = "conv_transpose2d/" + variant,
                .inputs = {{.name = "x", .shape = g.x},
                           {.name = "weight", .shape = {g.x[3], g.out, g.kernel_h, g.kernel_w}}},
                .forward =
                    [g](std::span<const Tensor> in) {
                      return conv_transpose2d(in[0], in[1], at_or_none(in, 2),
                                              {.stride = g.stride, .padding = g.padding});
                    },
                .reference =
                    [parameters](std::span<const Array> in) {
                      return reference::conv_transpose2d(in[0], in[1], at_or_none(in, 2), parameters);
                    },
                .options = json_options(g)};
  if (g.bias) result.inputs.push_back({.name = "bias", .shape = {g.out}});
  return result;
}

OpCase reflection_pad_case(const std::string& variant, const Shape& shape, int64_t padding) {
  return {.name = "reflection_pad2d/" + variant,
          .inputs = {{.name = "x", .shape = shape}},
          .forward = [padding](std::span<const Tensor> in) { return reflection_pad2d(in[0], padding); },
          .reference =
              [padding](std::span<const Array> in) { return reference::reflection_pad2d(in[0], padding); },
          .options = {{"padding", std::to_string(padding)}}};
}

/// One value that is not finite in the first input, elsewhere the usual numbers.
OpCase with_value(OpCase op_case, double value, size_t position) {
  op_case.inputs[0].fill = [value, position](std::span<double> values, Random& random) {
    fill::normal()(values, random);
    values[position] = value;
  };
  op_case.smooth = false;
  return op_case;
}

}  // namespace

std::vector<OpCase> conv_cases() {
  return {
      conv2d_case("k1", {.x = {2, 5, 4, 5}, .out = 7, .kernel_h = 1, .kernel_w = 1}),
      conv2d_case("k1_bias", {.x = {2, 3, 4, 16}, .out = 8, .kernel_h = 1, .kernel_w = 1, .bias = true}),
      conv2d_case("k1_s2", {.x = {1, 7, 6, 4}, .out = 3, .kernel_h = 1, .kernel_w = 1, .stride = 2}),
      conv2d_case("k3_p1", {.x = {2, 6, 5, 3}, .out = 4, .padding = 1}),
      conv2d_case("k3_p1_bias", {.x = {2, 4, 7, 5}, .out = 9, .padding = 1, .bias = true}),
      conv2d_case("k3_p0", {.x = {1, 5, 6, 2}, .out = 3}),
      conv2d_case("k3_p2", {.x = {1, 4, 4, 2}, .out = 3, .padding = 2}),
      conv2d_case("k3_p1_lanes", {.x = {1, 6, 9, 16}, .out = 16, .padding = 1, .bias = true}),
      conv2d_case("k3_p1_off_lanes", {.x = {1, 5, 9, 21}, .out = 17, .padding = 1}),
      conv2d_case("k3_p1_wide", {.x = {1, 3, 3, 35}, .out = 33, .padding = 1, .bias = true}),
      conv2d_case("k3_p1_single", {.x = {1, 4, 5, 1}, .out = 1, .padding = 1, .bias = true}),
      conv2d_case("k3_p1_pixel", {.x = {2, 1, 1, 3}, .out = 4, .padding = 1}),
      conv2d_case("k3_p1_row", {.x = {1, 1, 37, 4}, .out = 3, .padding = 1}),
      conv2d_case("k3_s2_p1", {.x = {2, 7, 6, 5}, .out = 9, .stride = 2, .padding = 1}),
      conv2d_case("k3_s2_p1_even", {.x = {1, 8, 8, 16}, .out = 8, .stride = 2, .padding = 1, .bias = true}),
      conv2d_case("k3_s3_p1", {.x = {1, 8, 7, 2}, .out = 3, .stride = 3, .padding = 1}),
      conv2d_case("k4_s2_p1",
                  {.x = {1, 6, 8, 3}, .out = 5, .kernel_h = 4, .kernel_w = 4, .stride = 2, .padding = 1}),
      conv2d_case("k5_s2_p2",
                  {.x = {1, 7, 7, 3}, .out = 2, .kernel_h = 5, .kernel_w = 5, .stride = 2, .padding = 2}),
      conv2d_case("k3x5_p1", {.x = {1, 5, 6, 3}, .out = 4, .kernel_h = 3, .kernel_w = 5, .padding = 1}),
      conv2d_case("k7_p3", {.x = {1, 6, 5, 3}, .out = 4, .kernel_h = 7, .kernel_w = 7, .padding = 3}),
      conv2d_case("k7_s2_p3",
                  {.x = {1, 8, 9, 2}, .out = 3, .kernel_h = 7, .kernel_w = 7, .stride = 2, .padding = 3}),
      conv2d_case("k7_reflect",
                  {.x = {2, 5, 6, 3}, .out = 5, .kernel_h = 7, .kernel_w = 7, .padding = 3, .reflect = true}),
      conv2d_case("k3_reflect", {.x = {1, 5, 6, 18}, .out = 7, .padding = 1, .reflect = true, .bias = true}),
      conv2d_case("k3_s2_reflect", {.x = {1, 6, 7, 4}, .out = 5, .stride = 2, .padding = 1, .reflect = true}),
      conv2d_parts_case("parts", {.x = {2, 6, 5, 24}, .out = 18, .padding = 1, .bias = true}, 16),
      conv2d_parts_case("parts_off_lanes", {.x = {1, 5, 7, 9}, .out = 5, .padding = 1}, 4),
      conv2d_parts_case("parts_reflect", {.x = {1, 5, 6, 20}, .out = 16, .padding = 1, .reflect = true}, 16),
      conv2d_parts_case("parts_s2", {.x = {1, 6, 7, 6}, .out = 3, .stride = 2, .padding = 1}, 2),
      conv2d_case("empty_batch", {.x = {0, 4, 5, 3}, .out = 2, .padding = 1, .bias = true}),
      with_value(conv2d_case("nan", {.x = {1, 6, 7, 5}, .out = 4, .padding = 1}), kNan, 5 * (2 * 7 + 3) + 1),
      with_value(conv2d_case("infinity", {.x = {1, 6, 7, 5}, .out = 4, .stride = 2, .padding = 1}), kInfinity,
                 5 * (3 * 7 + 2) + 4),
      conv_transpose2d_case(
          "k4_s2_p1", {.x = {2, 3, 4, 5}, .out = 3, .kernel_h = 4, .kernel_w = 4, .stride = 2, .padding = 1}),
      conv_transpose2d_case(
          "k4_s2_p1_pixel",
          {.x = {3, 1, 1, 27}, .out = 8, .kernel_h = 4, .kernel_w = 4, .stride = 2, .padding = 1}),
      conv_transpose2d_case("k4_s2_p1_to_one", {.x = {1, 5, 4, 16},
                                                .out = 1,
                                                .kernel_h = 4,
                                                .kernel_w = 4,
                                                .stride = 2,
                                                .padding = 1,
                                                .bias = true}),
      conv_transpose2d_case("k3", {.x = {1, 4, 5, 6}, .out = 17, .bias = true}),
      conv_transpose2d_case("k3_p1", {.x = {2, 4, 3, 2}, .out = 3, .padding = 1}),
      conv_transpose2d_case("k2_s3",
                            {.x = {1, 3, 2, 3}, .out = 4, .kernel_h = 2, .kernel_w = 2, .stride = 3}),
      conv_transpose2d_case("k1", {.x = {1, 3, 4, 9}, .out = 5, .kernel_h = 1, .kernel_w = 1}),
      conv_transpose2d_case("k2x3_s2",
                            {.x = {1, 3, 3, 2}, .out = 3, .kernel_h = 2, .kernel_w = 3, .stride = 2}),
      with_value(
          conv_transpose2d_case(
              "nan", {.x = {1, 4, 4, 3}, .out = 2, .kernel_h = 4, .kernel_w = 4, .stride = 2, .padding = 1}),
          kNan, 3 * (1 * 4 + 2)),
      reflection_pad_case("p0", {1, 3, 4, 2}, 0),
      reflection_pad_case("p1", {2, 3, 4, 5}, 1),
      reflection_pad_case("p3", {1, 4, 5, 3}, 3),
  };
}

std::vector<OpCase> large_conv_cases(int64_t side) {
  const int64_t half = side / 2;
  return {
      conv2d_case("k3_64_64", {.x = {1, side, side, 64}, .out = 64, .padding = 1, .bias = true}),
      conv2d_case("k3_256_256", {.x = {1, side / 4, side / 4, 256}, .out = 256, .padding = 1}),
      conv2d_case("k3_s2_64_128", {.x = {1, side, side, 64}, .out = 128, .stride = 2, .padding = 1}),
      conv2d_case(
          "k7_21_64",
          {.x = {1, half, half, 21}, .out = 64, .kernel_h = 7, .kernel_w = 7, .padding = 3, .reflect = true}),
      conv2d_case("k1_64_12",
                  {.x = {1, side, side, 64}, .out = 12, .kernel_h = 1, .kernel_w = 1, .bias = true}),
      conv_transpose2d_case(
          "k4_s2_64_32",
          {.x = {1, half, half, 64}, .out = 32, .kernel_h = 4, .kernel_w = 4, .stride = 2, .padding = 1}),
      reflection_pad_case("p3_21", {1, side, side, 21}, 3),
  };
}

}  // namespace opaline::check
