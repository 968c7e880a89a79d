// Every check of an operation's arguments: what is refused, and that the message names the operation and what
// it was given.
#include <catch2/catch.hpp>
#include <cmath>
#include <functional>
#include <string>
#include <vector>

#include "core/ops/activation.h"
#include "core/ops/arithmetic.h"
#include "core/ops/conv.h"
#include "core/ops/linear.h"
#include "core/ops/loss.h"
#include "core/ops/norm.h"
#include "core/ops/pool.h"
#include "core/ops/reduce.h"
#include "core/ops/resize.h"
#include "core/ops/shape.h"
#include "core/ops/unary.h"

namespace opaline {
namespace {

Tensor zeros(Shape shape, DType dtype = DType::kFloat32) {
  return Tensor::zeros(std::move(shape), dtype);
}

constexpr DType kWide = DType::kFloat64;
constexpr DType kInteger = DType::kInt64;

struct Refusal {
  std::function<Tensor()> call;
  std::string operation;
  std::vector<std::string> named;  ///< what the message must hold
};

void check_refusals(const std::vector<Refusal>& refusals) {
  for (const Refusal& refusal : refusals) {
    std::string message;
    try {
      refusal.call();
    } catch (const Error& error) {
      message = error.what();
    }
    INFO(refusal.operation << " said: " << (message.empty() ? "nothing" : message));
    CHECK(message.starts_with("[" + refusal.operation + "]"));
    for (const std::string& part : refusal.named) {
      INFO("looking for: " << part);
      CHECK(message.find(part) != std::string::npos);
    }
  }
}

TEST_CASE("convolutions refuse what does not fit") {
  const Tensor x = zeros({2, 6, 5, 20}), weight = zeros({64, 20, 3, 3});
  check_refusals({
      {[&] {
         return conv2d(zeros({6, 5, 20}), weight);
       },
       "conv2d",
       {"6x5x20"}},
      {[&] {
         return conv2d(x, zeros({64, 20, 9}));
       },
       "conv2d",
       {"64x20x9", "O x I x KH x KW"}},
      {[&] {
         return conv2d(x, zeros({64, 21, 3, 3}));
       },
       "conv2d",
       {"20 channels", "21", "2x6x5x20", "64x21x3x3"}},
      {[&] {
         return conv2d(x, zeros({64, 20, 3, 3}, kWide));
       },
       "conv2d",
       {"float32", "float64"}},
      {[&] { return conv2d(x, weight, zeros({63})); }, "conv2d", {"bias", "63", "64"}},
      {[&] { return conv2d(x, weight, zeros({64}, kWide)); }, "conv2d", {"bias", "float64"}},
      {[&] { return conv2d(x, weight, {}, {.stride = 0}); }, "conv2d", {"stride 0"}},
      {[&] { return conv2d(x, weight, {}, {.padding = -1}); }, "conv2d", {"padding -1"}},
      {[&] {
         return conv2d(x, zeros({1, 20, 7, 7}));
       },
       "conv2d",
       {"2x6x5x20", "7x7"}},
      {[&] {
         return conv2d(zeros({1, 6, 5, 20}, kInteger), zeros({1, 20, 1, 1}, kInteger));
       },
       "conv2d",
       {"int64"}},
      {[&] { return conv2d(x, weight, {}, {.padding = 5, .padding_mode = Padding::kReflect}); },
       "reflection_pad2d",
       {"padding 5", "2x6x5x20"}},
      {[&] { return reflection_pad2d(x, -1); }, "reflection_pad2d", {"padding -1"}},
      {[&] {
         return reflection_pad2d(zeros({2, 3}), 1);
       },
       "reflection_pad2d",
       {"2x3"}},
      {[&] {
         return conv_transpose2d(zeros({2, 3}), weight);
       },
       "conv_transpose2d",
       {"2x3"}},
      {[&] {
         return conv_transpose2d(x, zeros({20, 3}));
       },
       "conv_transpose2d",
       {"20x3", "I x O x KH x KW"}},
      {[&] { return conv_transpose2d(x, weight); }, "conv_transpose2d", {"20 channels", "64", "2x6x5x20"}},
      {[&] {
         return conv_transpose2d(x, zeros({20, 4, 3, 3}), zeros({20}));
       },
       "conv_transpose2d",
       {"bias", "20"}},
      {[&] {
         return conv_transpose2d(x, zeros({20, 4, 3, 3}), {}, {.stride = 0});
       },
       "conv_transpose2d",
       {"stride 0"}},
      {[&] {
         return conv_transpose2d(x, zeros({20, 4, 1, 1}), {}, {.padding = 3});
       },
       "conv_transpose2d",
       {"2x6x5x20", "padding 3"}},
  });
}

TEST_CASE("products refuse what does not fit") {
  check_refusals({
      {[] {
         return linear(zeros({4, 7}), zeros({3, 8}));
       },
       "linear",
       {"4x7", "3x8"}},
      {[] {
         return linear(zeros({}), zeros({3, 8}));
       },
       "linear",
       {"scalar", "3x8"}},
      {[] {
         return linear(zeros({4, 8}), zeros({3, 8, 1}));
       },
       "linear",
       {"3x8x1"}},
      {[] {
         return linear(zeros({4, 8}), zeros({3, 8}, kWide));
       },
       "linear",
       {"float32", "float64"}},
      {[] {
         return linear(zeros({4, 8}), zeros({3, 8}), zeros({8}));
       },
       "linear",
       {"bias", "8", "3"}},
      {[] {
         return matmul(zeros({2, 3}), zeros({2, 3}));
       },
       "matmul",
       {"2x3"}},
      {[] { return matmul(zeros({3}), zeros({3})); }, "matmul", {"3"}},
      {[] {
         return matmul(zeros({2, 3, 4}), zeros({3, 4, 5}));
       },
       "matmul",
       {"2x3x4", "3x4x5"}},
      {[] {
         return matmul(zeros({2, 3, 4}), zeros({4, 5}));
       },
       "matmul",
       {"2x3x4", "4x5"}},
      {[] {
         return matmul(zeros({3, 4}), zeros({4, 5}), {.transpose_a = true});
       },
       "matmul",
       {"3x4 (transposed)"}},
      {[] {
         return matmul(zeros({3, 4}), zeros({4, 5}), {.transpose_b = true});
       },
       "matmul",
       {"4x5 (transposed)"}},
      {[] {
         return matmul(zeros({3, 4}), zeros({4, 5}, kWide));
       },
       "matmul",
       {"float32", "float64"}},
  });
}

TEST_CASE("normalisations refuse what does not fit") {
  const Tensor c = zeros({5}), wrong = zeros({4}), wide = zeros({5}, kWide);
  const Tensor x = zeros({3, 5}), image = zeros({2, 3, 4, 5});
  check_refusals({
      {[&] { return layer_norm(zeros({}), c, c); }, "layer_norm", {"scalar"}},
      {[&] { return layer_norm(x, wrong, c); }, "layer_norm", {"weight", "4", "3x5"}},
      {[&] { return layer_norm(x, c, wrong); }, "layer_norm", {"bias", "4", "3x5"}},
      {[&] { return layer_norm(x, wide, c); }, "layer_norm", {"weight", "float64"}},
      {[&] { return batch_norm(c, c, c, c, c); }, "batch_norm", {"shape 5"}},
      {[&] { return batch_norm(x, wrong, c, c, c); }, "batch_norm", {"weight", "4", "3x5"}},
      {[&] { return batch_norm(x, c, wrong, c, c); }, "batch_norm", {"bias", "4", "3x5"}},
      {[&] { return batch_norm(x, c, c, wrong, c); }, "batch_norm", {"running_mean", "4", "3x5"}},
      {[&] { return batch_norm(x, c, c, c, wrong); }, "batch_norm", {"running_var", "4", "3x5"}},
      {[&] { return batch_norm(x, c, c, c, {}); }, "batch_norm", {"both"}},
      {[&] { return batch_norm(x, c, c, {}, {}, {.training = false}); }, "batch_norm", {"evaluation"}},
      {[&] {
         return batch_norm(zeros({0, 5}), c, c, c, c);
       },
       "batch_norm",
       {"0x5", "no values"}},
      {[&] { return instance_norm(x); }, "instance_norm", {"3x5"}},
      {[&] { return instance_norm(image, c, {}); }, "instance_norm", {"both"}},
      {[&] { return instance_norm(image, wrong, c); }, "instance_norm", {"weight", "4", "2x3x4x5"}},
      {[&] { return instance_norm(image, c, wrong); }, "instance_norm", {"bias", "4", "2x3x4x5"}},
      {[&] {
         return instance_norm(zeros({2, 0, 4, 5}));
       },
       "instance_norm",
       {"2x0x4x5"}},
  });
}

TEST_CASE("pointwise operations refuse what does not fit") {
  const Tensor integer = zeros({2}, kInteger);
  check_refusals({
      {[] {
         return add(zeros({2, 3}), zeros({2, 4}));
       },
       "add",
       {"2x3", "2x4"}},
      {[] {
         return sub(zeros({2, 3}), zeros({2}));
       },
       "sub",
       {"2x3", "2"}},
      {[] { return mul(zeros({2}), zeros({2}, kWide)); }, "mul", {"float32", "float64"}},
      {[] {
         return div(zeros({3, 1, 2}), zeros({4, 2, 2}));
       },
       "div",
       {"3x1x2", "4x2x2"}},
      {[&] { return add(integer, integer); }, "add", {"int64"}},
      {[&] { return affine(integer, 1.0); }, "affine", {"int64"}},
      {[&] { return relu(integer); }, "relu", {"int64"}},
      {[&] { return leaky_relu(integer); }, "leaky_relu", {"int64"}},
      {[&] { return gelu(integer); }, "gelu", {"int64"}},
      {[&] { return tanh(integer); }, "tanh", {"int64"}},
      {[&] { return sigmoid(integer); }, "sigmoid", {"int64"}},
      {[&] { return abs(integer); }, "abs", {"int64"}},
      {[&] { return square(integer); }, "square", {"int64"}},
      {[&] { return safe_sqrt(integer); }, "safe_sqrt", {"int64"}},
      {[&] { return clamp(integer, 0.0, 1.0); }, "clamp", {"int64"}},
      {[] { return clamp(zeros({2}), 1.0, 0.0); }, "clamp", {"1", "0"}},
      {[] { return clamp(zeros({2}), std::nan(""), 0.0); }, "clamp", {"nan"}},
      {[] { return softmax(zeros({})); }, "softmax", {"scalar"}},
      {[] {
         return softmax(zeros({2, 0}));
       },
       "softmax",
       {"2x0"}},
      {[] { return normalize(zeros({})); }, "normalize", {"scalar"}},
      {[&] { return normalize(integer); }, "normalize", {"int64"}},
  });
}

TEST_CASE("pooling and resampling refuse what does not fit") {
  const Tensor x = zeros({2, 6, 5, 3});
  check_refusals({
      {[] {
         return max_pool2d(zeros({6, 5, 3}));
       },
       "max_pool2d",
       {"6x5x3"}},
      {[&] { return max_pool2d(x, 0); }, "max_pool2d", {"kernel 0", "2x6x5x3"}},
      {[&] { return max_pool2d(x, 6); }, "max_pool2d", {"kernel 6", "2x6x5x3"}},
      {[] {
         return max_pool2d(zeros({1, 32, 32, 1}), 16);
       },
       "max_pool2d",
       {"kernel 16"}},
      {[] {
         return adaptive_avg_pool2d(zeros({6, 5, 3}), 1, 1);
       },
       "adaptive_avg_pool2d",
       {"6x5x3"}},
      {[] {
         return adaptive_avg_pool2d(zeros({1, 0, 5, 3}), 1, 1);
       },
       "adaptive_avg_pool2d",
       {"1x0x5x3"}},
      {[&] { return adaptive_avg_pool2d(x, 0, 2); }, "adaptive_avg_pool2d", {"0x2"}},
      {[] {
         return upsample_bilinear(zeros({6, 5, 3}), {.height = 2, .width = 2});
       },
       "upsample_bilinear",
       {"6x5x3"}},
      {[&] { return upsample_bilinear(x, {.height = 2}); }, "upsample_bilinear", {"2x0"}},
      {[] {
         return upsample_nearest(zeros({6, 5, 3}), {.height = 2, .width = 2});
       },
       "upsample_nearest",
       {"6x5x3"}},
      {[&] { return upsample_nearest(x, {.width = 2}); }, "upsample_nearest", {"0x2"}},
      {[&] { return upsample_nearest(x, {.height = 2, .width = 2, .align_corners = true}); },
       "upsample_nearest",
       {"align_corners"}},
  });
}

TEST_CASE("reductions and moves refuse what does not fit") {
  const Tensor x = zeros({2, 3, 4});
  check_refusals({
      {[&] { return sum(x, 3); }, "sum", {"dimension 3", "2x3x4"}},
      {[&] { return mean(x, -4); }, "mean", {"dimension -4", "2x3x4"}},
      {[] { return sum(zeros({2}, kInteger)); }, "sum", {"int64"}},
      {[] { return concat({}); }, "concat", {"nothing"}},
      {[&] {
         return concat({x, zeros({2, 2, 5})});
       },
       "concat",
       {"2x3x4", "2x2x5"}},
      {[&] {
         return concat({x, zeros({2, 3})});
       },
       "concat",
       {"2x3x4", "2x3"}},
      {[&] {
         return concat({x, zeros({2, 3, 4}, kWide)});
       },
       "concat",
       {"float32", "float64"}},
      {[&] {
         return concat({x, x}, 3);
       },
       "concat",
       {"dimension 3"}},
      {[&] {
         return reshape(x, {5, 5});
       },
       "reshape",
       {"24", "2x3x4", "5x5"}},
      {[&] {
         return reshape(x, {5, -1});
       },
       "reshape",
       {"2x3x4"}},
      {[&] {
         return reshape(x, {-1, -1});
       },
       "reshape",
       {"2x3x4"}},
      {[&] {
         return reshape(x, {-2, -12});
       },
       "reshape",
       {"2x3x4", "-2x-12"}},
      {[&] {
         return reshape(x, {-1, 0});
       },
       "reshape",
       {"2x3x4"}},
      {[&] {
         return permute(x, {0, 1});
       },
       "permute",
       {"0x1", "2x3x4"}},
      {[&] {
         return permute(x, {0, 1, 1});
       },
       "permute",
       {"0x1x1", "2x3x4"}},
      {[&] {
         return permute(x, {0, 1, 3});
       },
       "permute",
       {"0x1x3", "2x3x4"}},
      {[&] {
         return permute(x, {0, -1, 1});
       },
       "permute",
       {"2x3x4"}},
      {[&] { return slice(x, 3, 0, 1); }, "slice", {"dimension 3", "2x3x4"}},
      {[&] { return slice(x, 1, 2, 4); }, "slice", {"[2, 4)", "2x3x4"}},
      {[&] { return slice(x, 1, -1, 2); }, "slice", {"[-1, 2)", "2x3x4"}},
      {[&] { return slice(x, 1, 2, 1); }, "slice", {"[2, 1)", "2x3x4"}},
      {[&] {
         return expand(x, {2, 3, 5});
       },
       "expand",
       {"2x3x4", "2x3x5"}},
      {[&] {
         return expand(x, {3, 4});
       },
       "expand",
       {"2x3x4", "3x4"}},
      {[] {
         return to_nhwc(zeros({2, 3}));
       },
       "permute",
       {"2x3"}},
      {[] {
         return to_nchw(zeros({2, 3}));
       },
       "permute",
       {"2x3"}},
  });
}

TEST_CASE("losses refuse what does not fit") {
  const Tensor x = zeros({2, 3, 4, 5}), mask = zeros({2, 3, 4, 1});
  using Masked = Tensor (*)(const Tensor&, const Tensor&, const Tensor&);
  const std::vector<std::pair<std::string, Masked>> masked = {
      {"masked_l1_loss", masked_l1_loss}, {"masked_mse_loss", masked_mse_loss}, {"cosine_loss", cosine_loss}};
  for (const auto& [name, loss] : masked) {
    check_refusals({
        {[&, f = loss] {
           return f(x, zeros({2, 3, 4, 1}), mask);
         },
         name,
         {"2x3x4x5", "2x3x4x1"}},
        {[&, f = loss] {
           return f(x, zeros({2, 3, 4, 5}, kWide), mask);
         },
         name,
         {"float32", "float64"}},
        {[&, f = loss] {
           return f(x, x, zeros({2, 3, 4}));
         },
         name,
         {"2x3x4x5", "2x3x4", "mask"}},
        {[&, f = loss] { return f(x, x, x); }, name, {"mask"}},
        {[&, f = loss] {
           return f(x, x, zeros({2, 3, 4, 1}, kWide));
         },
         name,
         {"mask", "float64"}},
        {[&, f = loss] {
           return f(zeros({2, 3}), zeros({2, 3}), zeros({2, 1}));
         },
         name,
         {"2x3", "mask"}},
    });
  }
  check_refusals({
      {[] {
         return l1_loss(zeros({2, 3}), zeros({3, 2}));
       },
       "l1_loss",
       {"2x3", "3x2"}},
      {[] {
         return mse_loss(zeros({2, 3}), zeros({2, 3}, kWide));
       },
       "mse_loss",
       {"float32", "float64"}},
  });
}

}  // namespace
}  // namespace opaline
