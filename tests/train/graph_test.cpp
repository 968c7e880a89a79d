// What a graph takes, against counts by hand.
#include "train/graph.h"

#include <catch2/catch.hpp>

#include "core/autograd.h"
#include "core/ops/activation.h"
#include "core/ops/arithmetic.h"
#include "core/ops/conv.h"
#include "core/ops/linear.h"
#include "core/ops/shape.h"

namespace opaline {
namespace {

constexpr int64_t kFloat = 4;

Tensor leaf(Shape shape, bool wanted = true) {
  return Tensor::zeros(std::move(shape)).set_requires_grad(wanted);
}

TEST_CASE("work and bytes of a convolution, with and without the gradient of its input") {
  const bool input_wanted = GENERATE(false, true);
  // Two parts of one image, of which the first wants its gradient or not.
  const Tensor parts[] = {leaf({2, 8, 8, 3}, input_wanted), leaf({2, 8, 8, 5}, false)};
  const int64_t x0 = 2 * 64 * 3, x1 = 2 * 64 * 5, w = 4 * 8 * 9, b = 4, y = 2 * 64 * 4;
  const WorkCount count = count_work(conv2d(parts, leaf({4, 8, 3, 3}), leaf({4}), {.padding = 1}));
  CHECK(count.forward == y * 8 * 9);
  CHECK(count.backward == count.forward + (input_wanted ? y * 3 * 9 : 0));
  CHECK(count.forward_bytes == kFloat * (x0 + x1 + w + b + y));
  // Read: dy, and x for the gradient of the weight; for that of the input the weight. Written: dw and db;
  // dx0.
  CHECK(count.backward_bytes == kFloat * (y + x0 + x1 + w + b + (input_wanted ? w + x0 : 0)));
}

TEST_CASE("bytes follow what the gradients are functions of") {
  const int64_t n = 6 * 10;
  const Tensor a = leaf({6, 10}), b = leaf({6, 10}), constant = leaf({6, 10}, false);
  // Sums: dy read, two gradients written. Products: both factors read too, but none for a constant one.
  CHECK(count_work(add(a, b)).forward_bytes == kFloat * 3 * n);
  CHECK(count_work(add(a, b)).backward_bytes == kFloat * 3 * n);
  CHECK(count_work(mul(a, b)).backward_bytes == kFloat * 5 * n);
  CHECK(count_work(mul(a, constant)).backward_bytes == kFloat * 3 * n);
  CHECK(count_work(gelu(a)).forward_bytes == kFloat * 2 * n);
  CHECK(count_work(gelu(a)).backward_bytes == kFloat * 3 * n);
  CHECK(count_work(reshape(a, {60})).forward_bytes == 0);
  CHECK(count_work(reshape(a, {60})).backward_bytes == 0);
  CHECK(count_work(gelu(a)).forward == 0);
}

TEST_CASE("bytes of a chain add up, and those of float64 are twice as many") {
  const auto chain = [](DType dtype) {
    const auto wanted = [&](Shape shape) {
      return Tensor::zeros(std::move(shape), dtype).set_requires_grad(true);
    };
    return count_work(gelu(linear(wanted({5, 3}), wanted({7, 3}), wanted({7}))));
  };
  const WorkCount count = chain(DType::kFloat32);
  CHECK(count.forward == 5 * 7 * 3);
  CHECK(count.backward == 2 * count.forward);
  CHECK(count.forward_bytes == kFloat * (15 + 21 + 7 + 35 + 35 + 35));
  CHECK(count.backward_bytes == kFloat * ((35 + 15 + 21) + (15 + 21 + 7) + 3 * 35));
  CHECK(chain(DType::kFloat64).forward_bytes == 2 * count.forward_bytes);
  CHECK(chain(DType::kFloat64).backward_bytes == 2 * count.backward_bytes);
}

}  // namespace
}  // namespace opaline
