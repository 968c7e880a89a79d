// Reductions and operations that move elements.
#include <fmt/format.h>
#include <fmt/ranges.h>

#include <limits>

#include "core/check/op_case.h"
#include "core/check/reference.h"
#include "core/ops/reduce.h"
#include "core/ops/shape.h"

namespace opaline::check {
namespace {

OpCase reduce_all_case(const std::string& name, Tensor (*f)(const Tensor&), Array (*reference)(const Array&),
                       Shape shape, Fill fill = fill::normal()) {
  return {.name = name,
          .inputs = {{.name = "x", .shape = std::move(shape), .fill = std::move(fill)}},
          .forward = [f](std::span<const Tensor> in) { return f(in[0]); },
          .reference = [reference](std::span<const Array> in) { return reference(in[0]); }};
}

OpCase reduce_axis_case(const std::string& name, Tensor (*f)(const Tensor&, int64_t, bool),
                        Array (*reference)(const Array&, size_t, bool), const Shape& shape, int64_t axis,
                        bool keepdim) {
  const auto front = static_cast<size_t>(axis < 0 ? axis + static_cast<int64_t>(shape.size()) : axis);
  return {.name = name,
          .inputs = {{.name = "x", .shape = shape}},
          .forward = [=](std::span<const Tensor> in) { return f(in[0], axis, keepdim); },
          .reference = [=](std::span<const Array> in) { return reference(in[0], front, keepdim); },
          .options = {{"axis", std::to_string(axis)}, {"keepdim", fmt::format("{}", keepdim)}}};
}

void add_reduce_cases(std::vector<OpCase>& cases, const std::string& operation, Tensor (*all)(const Tensor&),
                      Array (*reference_all)(const Array&), Tensor (*axis)(const Tensor&, int64_t, bool),
                      Array (*reference_axis)(const Array&, size_t, bool)) {
  const auto add = [&](const std::string& variant, Shape shape, Fill fill = fill::normal()) {
    cases.push_back(
        reduce_all_case(operation + "/" + variant, all, reference_all, std::move(shape), std::move(fill)));
  };
  const auto add_axis = [&](const std::string& variant, const Shape& shape, int64_t d, bool keepdim) {
    cases.push_back(reduce_axis_case(operation + "/" + variant, axis, reference_axis, shape, d, keepdim));
  };
  add("all", {2, 3, 4, 5});
  add("scalar", {});
  add("blocks", {3, 4099});  // more than one block of the summation, and an incomplete one
  add_axis("first", {3, 4, 5}, 0, false);
  add_axis("middle", {3, 4, 5}, 1, false);
  add_axis("last", {3, 4, 5}, -1, false);
  add_axis("keepdim", {3, 4, 5}, 1, true);
  add_axis("wide", {2, 2, 300}, 1, false);
  add_axis("vector", {6}, 0, false);
  add("nan", {5}, fill::values({1.0, std::numeric_limits<double>::quiet_NaN(), 2.0}));
  cases.back().smooth = false;
}

OpCase concat_case(const std::string& variant, const std::vector<Shape>& shapes, int64_t axis) {
  const auto rank = static_cast<int64_t>(shapes[0].size());
  const auto front = static_cast<size_t>(axis < 0 ? axis + rank : axis);
  OpCase result{.name = "concat/" + variant,
                .inputs = {},
                .forward = [axis](std::span<const Tensor> in) { return concat(in, axis); },
                .reference = [front](std::span<const Array> in) { return reference::concat(in, front); },
                .options = {{"axis", std::to_string(axis)}}};
  for (size_t i = 0; i < shapes.size(); ++i) {
    result.inputs.push_back({.name = fmt::format("part{}", i), .shape = shapes[i]});
  }
  return result;
}

std::string to_json(const std::vector<int64_t>& list) {
  return fmt::format("[{}]", fmt::join(list, ","));
}

OpCase reshape_case(const std::string& variant, const Shape& from, const Shape& to, const Shape& result) {
  return {.name = "reshape/" + variant,
          .inputs = {{.name = "x", .shape = from}},
          .forward = [to](std::span<const Tensor> in) { return reshape(in[0], to); },
          .reference = [result](std::span<const Array> in) { return reference::reshape(in[0], result); },
          .options = {{"shape", to_json(to)}}};
}

OpCase permute_case(const std::string& variant, const Shape& shape, const std::vector<int64_t>& order) {
  return {.name = "permute/" + variant,
          .inputs = {{.name = "x", .shape = shape}},
          .forward = [order](std::span<const Tensor> in) { return permute(in[0], order); },
          .reference =
              [order](std::span<const Array> in) {
                return reference::permute(in[0], std::vector<size_t>(order.begin(), order.end()));
              },
          .options = {{"order", to_json(order)}}};
}

OpCase slice_case(const std::string& variant, const Shape& shape, int64_t axis, int64_t begin, int64_t end) {
  const auto front = static_cast<size_t>(axis < 0 ? axis + static_cast<int64_t>(shape.size()) : axis);
  return {.name = "slice/" + variant,
          .inputs = {{.name = "x", .shape = shape}},
          .forward = [=](std::span<const Tensor> in) { return slice(in[0], axis, begin, end); },
          .reference = [=](std::span<const Array> in) { return reference::slice(in[0], front, begin, end); },
          .options = {{"axis", std::to_string(axis)},
                      {"begin", std::to_string(begin)},
                      {"end", std::to_string(end)}}};
}

OpCase expand_case(const std::string& variant, const Shape& from, const Shape& to) {
  return {.name = "expand/" + variant,
          .inputs = {{.name = "x", .shape = from}},
          .forward = [to](std::span<const Tensor> in) { return expand(in[0], to); },
          .reference = [to](std::span<const Array> in) { return reference::expand(in[0], to); },
          .options = {{"shape", to_json(to)}}};
}

OpCase layout_case(const std::string& name, Tensor (*f)(const Tensor&), const Shape& shape,
                   const std::vector<size_t>& order) {
  return {.name = name,
          .inputs = {{.name = "x", .shape = shape}},
          .forward = [f](std::span<const Tensor> in) { return f(in[0]); },
          .reference = [order](std::span<const Array> in) { return reference::permute(in[0], order); }};
}

}  // namespace

std::vector<OpCase> reduce_cases() {
  std::vector<OpCase> cases;
  add_reduce_cases(cases, "sum", sum, reference::sum, sum, reference::sum);
  add_reduce_cases(cases, "mean", mean, reference::mean, mean, reference::mean);
  return cases;
}

std::vector<OpCase> shape_cases() {
  return {
      concat_case("channels", {{2, 3, 2, 4}, {2, 3, 2, 1}, {2, 3, 2, 17}}, -1),
      concat_case("first", {{2, 3}, {1, 3}}, 0),
      concat_case("middle", {{2, 1, 3}, {2, 4, 3}}, 1),
      concat_case("single", {{2, 3}}, 1),
      concat_case("with_empty", {{2, 0}, {2, 3}}, -1),
      reshape_case("flatten", {2, 3, 4}, {2, -1}, {2, 12}),
      reshape_case("split", {6, 4}, {2, 3, 2, 2}, {2, 3, 2, 2}),
      reshape_case("to_scalar", {1, 1}, {}, {}),
      permute_case("reverse", {2, 3, 4}, {2, 1, 0}),
      permute_case("heads", {2, 5, 3, 4}, {0, 2, 1, 3}),
      permute_case("matrix", {7, 19}, {1, 0}),
      permute_case("same", {2, 3}, {0, 1}),
      permute_case("empty", {0, 3, 2}, {2, 0, 1}),
      slice_case("channels", {2, 3, 2, 7}, -1, 2, 5),
      slice_case("first", {4, 3}, 0, 0, 1),
      slice_case("end", {2, 5, 3}, 1, 3, 5),
      slice_case("nothing", {2, 5}, 1, 2, 2),
      slice_case("whole", {2, 5}, 1, 0, 5),
      expand_case("pixels", {2, 1, 1, 5}, {2, 3, 4, 5}),
      expand_case("leading", {3}, {2, 3}),
      expand_case("scalar", {}, {2, 2}),
      expand_case("same", {2, 3}, {2, 3}),
      layout_case("to_nhwc/image", to_nhwc, {2, 3, 4, 5}, {0, 2, 3, 1}),
      layout_case("to_nchw/image", to_nchw, {2, 3, 4, 5}, {0, 3, 1, 2}),
  };
}

std::vector<OpCase> large_shape_cases(int64_t side) {
  const Shape image{1, side, side, 64};
  return {
      reduce_all_case("sum/all", sum, reference::sum, image),
      reduce_axis_case("mean/channels", mean, reference::mean, image, -1, false),
      concat_case("64_64", {image, image}, -1),
      slice_case("channels", image, -1, 16, 48),
      permute_case("heads", {1, side, 8, 64}, {0, 2, 1, 3}),
      expand_case("pixels", {1, 1, 1, 8}, {1, side, side, 8}),
      layout_case("to_nchw/64", to_nchw, image, {0, 3, 1, 2}),
      layout_case("to_nhwc/64", to_nhwc, {1, 64, side, side}, {0, 2, 3, 1}),
  };
}

}  // namespace opaline::check
