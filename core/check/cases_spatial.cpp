// Pooling and resampling of images.
#include <fmt/format.h>

#include <limits>

#include "core/check/op_case.h"
#include "core/check/reference.h"
#include "core/ops/pool.h"
#include "core/ops/resize.h"

namespace opaline::check {
namespace {

constexpr double kNan = std::numeric_limits<double>::quiet_NaN();

OpCase max_pool_case(const std::string& variant, const Shape& shape, int64_t kernel = 2,
                     Fill fill = fill::distinct()) {
  return {.name = "max_pool2d/" + variant,
          .inputs = {{.name = "x", .shape = shape, .fill = std::move(fill)}},
          .forward = [kernel](std::span<const Tensor> in) { return max_pool2d(in[0], kernel); },
          .reference = [kernel](std::span<const Array> in) { return reference::max_pool2d(in[0], kernel); },
          .options = {{"kernel", std::to_string(kernel)}}};
}

OpCase adaptive_case(const std::string& variant, const Shape& shape, int64_t height, int64_t width) {
  return {.name = "adaptive_avg_pool2d/" + variant,
          .inputs = {{.name = "x", .shape = shape}},
          .forward = [=](std::span<const Tensor> in) { return adaptive_avg_pool2d(in[0], height, width); },
          .reference =
              [=](std::span<const Array> in) { return reference::adaptive_avg_pool2d(in[0], height, width); },
          .options = {{"height", std::to_string(height)}, {"width", std::to_string(width)}}};
}

OpCase bilinear_case(const std::string& variant, const Shape& shape, const UpsampleOptions& o) {
  return {.name = "upsample_bilinear/" + variant,
          .inputs = {{.name = "x", .shape = shape}},
          .forward = [o](std::span<const Tensor> in) { return upsample_bilinear(in[0], o); },
          .reference =
              [o](std::span<const Array> in) {
                return reference::upsample_bilinear(in[0], o.height, o.width, o.align_corners);
              },
          .options = {{"height", std::to_string(o.height)},
                      {"width", std::to_string(o.width)},
                      {"align_corners", fmt::format("{}", o.align_corners)}}};
}

OpCase nearest_case(const std::string& variant, const Shape& shape, int64_t height, int64_t width) {
  return {.name = "upsample_nearest/" + variant,
          .inputs = {{.name = "x", .shape = shape}},
          .forward =
              [=](std::span<const Tensor> in) {
                return upsample_nearest(in[0], {.height = height, .width = width});
              },
          .reference =
              [=](std::span<const Array> in) { return reference::upsample_nearest(in[0], height, width); },
          .options = {{"height", std::to_string(height)}, {"width", std::to_string(width)}}};
}

OpCase rough(OpCase op_case) {
  op_case.smooth = false;
  return op_case;
}

}  // namespace

std::vector<OpCase> pool_cases() {
  return {
      max_pool_case("even", {2, 4, 6, 3}),
      max_pool_case("odd", {1, 5, 7, 4}),
      max_pool_case("lanes", {1, 4, 4, 16}),
      max_pool_case("k3", {2, 6, 7, 5}, 3),
      max_pool_case("k1", {1, 3, 2, 2}, 1),
      max_pool_case("whole", {2, 4, 4, 3}, 4),
      // Behind a ReLU windows of zeros are common: the first of equal values takes the gradient.
      rough(max_pool_case("ties", {1, 4, 4, 2}, 2, fill::values({0.0, 0.0, 1.0, 0.0, 1.0, 1.0, 0.0}))),
      rough(max_pool_case("nan", {1, 4, 4, 1}, 2,
                          fill::values({kNan, 1, 2, kNan, 3, 4, 5, 6, 0, kNan, kNan, 1, 2, 3, 4, kNan}))),
      adaptive_case("halves", {2, 4, 6, 3}, 2, 3),
      adaptive_case("overlapping", {1, 7, 5, 4}, 3, 2),
      adaptive_case("larger", {1, 3, 4, 2}, 5, 7),
      adaptive_case("one", {2, 3, 5, 17}, 1, 1),
      adaptive_case("same", {1, 3, 4, 2}, 3, 4),
  };
}

std::vector<OpCase> resize_cases() {
  std::vector<OpCase> cases = {
      nearest_case("double", {2, 3, 4, 3}, 6, 8),     nearest_case("odd", {1, 5, 3, 2}, 7, 8),
      nearest_case("smaller", {1, 6, 7, 2}, 4, 3),    nearest_case("same", {1, 3, 4, 2}, 3, 4),
      nearest_case("from_pixel", {2, 1, 1, 5}, 3, 2),
  };
  for (const bool align : {true, false}) {
    const std::string name = align ? "aligned_" : "half_pixel_";
    const auto add = [&](const std::string& variant, const Shape& shape, int64_t h, int64_t w) {
      cases.push_back(
          bilinear_case(name + variant, shape, {.height = h, .width = w, .align_corners = align}));
    };
    add("double", {2, 3, 4, 3}, 6, 8);
    add("lanes", {1, 2, 3, 16}, 4, 6);
    add("odd", {1, 5, 3, 2}, 7, 8);
    add("smaller", {1, 6, 7, 2}, 4, 3);
    add("same", {1, 3, 4, 2}, 3, 4);
    add("to_pixel", {1, 3, 4, 2}, 1, 1);
    add("from_pixel", {2, 1, 1, 3}, 3, 2);
  }
  OpCase nan = bilinear_case("nan", {1, 5, 5, 1}, {.height = 10, .width = 10});
  nan.inputs[0].fill = [](std::span<double> values, Random& random) {
    fill::normal()(values, random);
    values[2 * 5 + 2] = kNan;
  };
  cases.push_back(rough(std::move(nan)));
  return cases;
}

std::vector<OpCase> large_spatial_cases(int64_t side) {
  return {
      max_pool_case("64", {1, side, side, 64}, 2, fill::normal()),
      adaptive_case("64", {1, side, side, 64}, side / 8, side / 8),
      bilinear_case("128", {1, side / 2, side / 2, 128},
                    {.height = side, .width = side, .align_corners = true}),
      nearest_case("128", {1, side / 2, side / 2, 128}, side, side),
  };
}

}  // namespace opaline::check
