// The training losses against values worked out by hand, and what has no value of its own: empty masks,
// single pixels.
#include "train/losses.h"

#include <catch2/catch.hpp>
#include <cmath>

#include "core/autograd.h"
#include "core/error.h"

namespace opaline {
namespace {

Tensor tensor_of(Shape shape, const std::vector<float>& values) {
  Tensor tensor(std::move(shape));
  std::copy(values.begin(), values.end(), tensor.values<float>().begin());
  return tensor;
}

// Two images of 1 x 2 pixels. The first mask has one pixel, the second both.
struct Case {
  CascadeOutput output;
  LossTargets targets;
  Case() {
    output.normal = tensor_of({2, 1, 2, 3}, {1, 0, 0, 9, 9, 9, 0, 0, 2, 0, 3, 0});
    targets.normal = tensor_of({2, 1, 2, 3}, {0, 0, 1, 0, 0, 1, 0, 0, 1, 0, 0, 1});
    output.depth = tensor_of({2, 1, 2, 1}, {3, 7, 1, 2});
    targets.depth = tensor_of({2, 1, 2, 1}, {1, 0, 1, 0});
    targets.mask = tensor_of({2, 1, 2, 1}, {1, 0, 1, 1});
    output.illumination = tensor_of({2, 2}, {1, 2, 3, 4});
    targets.illumination = tensor_of({2, 2}, {0, 0, 3, 1});
    output.sss = tensor_of({2, 1}, {1, -2});
    targets.sss = tensor_of({2, 1}, {0, 0});
    output.reconstruction = tensor_of({2, 1, 2, 1}, {0, 5, 1, 1});
    targets.reconstruction = tensor_of({2, 1, 2, 1}, {4, 0, 1, 3});
  }
};

CascadeOutput only_normal(const Case& c) {
  CascadeOutput output;
  output.normal = c.output.normal;
  return output;
}

double value_of(const Losses& losses, std::string_view name) {
  for (const LossValue& term : losses.terms) {
    if (term.name == name) return term.value.item();
  }
  FAIL("no term " << name);
  return 0.0;
}

TEST_CASE("each loss has the value that its formula gives, weighted into the total") {
  const Case c;
  LossOptions options;
  SECTION("L1") {
    for (LossTerm* term :
         {&options.normal, &options.depth, &options.illumination, &options.sss, &options.reconstruction}) {
      term->kind = LossKind::kL1;
    }
    const Losses losses = compute_losses(options, c.output, c.targets);
    // Image 1: |1| + |0| + |-1| over 3. Image 2: pixels 1 and 0 + 3 + 1 = 5, over 6.
    CHECK(value_of(losses, "normal") == Approx((2.0 / 3.0 + 5.0 / 6.0) / 2.0));
    CHECK(value_of(losses, "depth") == Approx((2.0 + 1.0) / 2.0));
    CHECK(value_of(losses, "illumination") == Approx((1.0 + 2.0 + 0.0 + 3.0) / 4.0));
    CHECK(value_of(losses, "sss") == Approx(1.5));
    CHECK(value_of(losses, "reconstruction") == Approx((4.0 + 1.0) / 2.0));
    CHECK(losses.total.item() == Approx(100.0 * 0.75 + 1.0 * 1.5 + 0.1 * 1.5 + 1.0 * 1.5 + 1.0 * 2.5));
  }
  SECTION("L2") {
    for (LossTerm* term :
         {&options.normal, &options.depth, &options.illumination, &options.sss, &options.reconstruction}) {
      term->kind = LossKind::kL2;
      term->weight = 2.0;
    }
    const Losses losses = compute_losses(options, c.output, c.targets);
    CHECK(value_of(losses, "normal") == Approx((2.0 / 3.0 + (1.0 + 9.0 + 1.0) / 6.0) / 2.0));
    CHECK(value_of(losses, "depth") == Approx((4.0 + (0.0 + 4.0) / 2.0) / 2.0));
    CHECK(value_of(losses, "illumination") == Approx((1.0 + 4.0 + 0.0 + 9.0) / 4.0));
    CHECK(value_of(losses, "sss") == Approx((1.0 + 4.0) / 2.0));
    CHECK(value_of(losses, "reconstruction") == Approx((16.0 + (0.0 + 4.0) / 2.0) / 2.0));
    double sum = 0.0;
    for (const LossValue& term : losses.terms) sum += 2.0 * term.value.item();
    CHECK(losses.total.item() == Approx(sum));
  }
  SECTION("cosine of the normals: 1 - cos, whatever the length") {
    options.normal.kind = LossKind::kCosine;
    const Losses losses = compute_losses(options, c.output, c.targets);
    CHECK(value_of(losses, "normal") == Approx((1.0 + (0.0 + 1.0) / 2.0) / 2.0));
  }
}

TEST_CASE("a term without weight or output is not computed") {
  Case c;
  LossOptions options;
  options.depth.weight = 0.0;
  c.output.sss = {};
  const Losses losses = compute_losses(options, c.output, c.targets);
  REQUIRE(losses.terms.size() == 3);
  CHECK(losses.terms[0].name == "normal");
  CHECK(losses.terms[1].name == "illumination");
  CHECK(losses.terms[2].name == "reconstruction");
  CHECK_THROWS_AS(compute_losses({.normal = {.weight = 0.0}}, only_normal(c), c.targets), Error);
}

TEST_CASE("an empty mask gives a loss of zero and a gradient of zero") {
  Case c;
  c.targets.mask = Tensor::zeros({2, 1, 2, 1});
  const LossKind kind = GENERATE(LossKind::kL1, LossKind::kL2, LossKind::kCosine);
  LossOptions options{.normal = {.weight = 1.0, .kind = kind}};
  c.output.normal.set_requires_grad(true);
  const Losses losses = compute_losses(options, only_normal(c), c.targets);
  CHECK(losses.total.item() == 0.0);
  backward(losses.total);
  for (const float g : std::as_const(c.output.normal).grad().values<float>()) CHECK(g == 0.0F);
}

}  // namespace
}  // namespace opaline
