#include "models/cascade.h"

#include <catch2/catch.hpp>
#include <cmath>

#include "core/autograd.h"
#include "core/ops/arithmetic.h"
#include "core/ops/pool.h"
#include "core/ops/reduce.h"
#include "core/ops/resize.h"
#include "core/ops/shape.h"
#include "core/ops/unary.h"
#include "nn/pattern.h"

namespace opaline {
namespace {

using Catch::Contains;

constexpr CascadeOptions kSmall{
    .network = {.variant = Variant::kPaper, .input_channels = 19, .image_size = 32, .width = 4}};
constexpr int64_t kBatch = 2;

CascadeInput small_input(int64_t size = 32) {
  return {.image = test::pattern_tensor({kBatch, size, size, 19}, 1, 1.0, 0.0, DType::kFloat32),
          .bsdf = test::pattern_tensor({kBatch, size, size, 12}, 2, 1.0, 0.0, DType::kFloat32),
          .mask = {}};
}

bool equal(const Tensor& a, const Tensor& b) {
  if (a.shape() != b.shape()) return false;
  for (int64_t i = 0; i < a.numel(); ++i) {
    if (!(a.at(i) == b.at(i))) return false;
  }
  return true;
}

TEST_CASE("a stage has the networks that it needs") {
  using Names = std::vector<std::string>;
  CHECK(Cascade({.network = kSmall.network, .stage = 1}).network_names() ==
        Names{"normal", "depth", "illumination"});
  CHECK(Cascade(kSmall).network_names() ==
        Names{"normal", "depth", "illumination", "illumination_decoder", "sss", "reconstruction"});
  CHECK_FALSE(Cascade({.network = kSmall.network, .reconstruction = false}).has("reconstruction"));
  CHECK_THROWS_WITH(Cascade({.network = kSmall.network, .stage = 3}), Contains("stage 3"));
  Cascade stage1({.network = kSmall.network, .stage = 1});
  CHECK_THROWS_WITH(stage1.network("sss"), Contains("no network 'sss'") && Contains("illumination"));
}

TEST_CASE("stage 1 computes what is wanted and nothing else") {
  Cascade cascade({.network = kSmall.network, .stage = 1});
  cascade.initialize(3);
  const NoGradGuard no_grad;
  const CascadeOutput all = cascade.forward(small_input());
  CHECK(all.normal.shape() == Shape{kBatch, 32, 32, 3});
  CHECK(all.depth.shape() == Shape{kBatch, 32, 32, 1});
  CHECK(all.illumination.shape() == Shape{kBatch, 28});
  CHECK_FALSE(all.sss.defined());

  const CascadeOutput depth =
      cascade.forward(small_input(), {.normal = false, .illumination = false, .sss = false});
  CHECK_FALSE(depth.normal.defined());
  CHECK_FALSE(depth.illumination.defined());
  CHECK(equal(depth.depth, all.depth));
  CHECK_THROWS_WITH(cascade.forward(small_input(), {.sss = true}), Contains("illumination_decoder"));
}

TEST_CASE("stage 2 joins the networks in the reference's channel order") {
  Cascade cascade(kSmall);
  cascade.initialize(3);
  cascade.set_training(false);
  const NoGradGuard no_grad;
  // At twice the build size the illumination map has to be resized.
  for (const int64_t size : {32, 64}) {
    const CascadeInput input = small_input(size);
    const CascadeOutput out = cascade.forward(input);
    CHECK(out.sss.shape() == Shape{kBatch, 7});
    CHECK(out.reconstruction.shape() == Shape{kBatch, size, size, 12});

    const Tensor map = cascade.network("illumination_decoder").forward(out.illumination);
    CHECK(map.size(1) == 32);
    CHECK(equal(out.illumination_map, upsample_bilinear(map, {.height = size, .width = size})));
    const Tensor sss_input = concat({out.illumination_map, out.normal, out.depth, input.image});
    CHECK(equal(out.sss, cascade.network("sss").forward(sss_input)));

    const Tensor values = expand(reshape(out.sss, {kBatch, 1, 1, 7}), {kBatch, size, size, 7});
    CHECK(equal(out.reconstruction, cascade.network("reconstruction").forward(concat({input.bsdf, values}))));
  }
  CascadeInput input = small_input();
  input.bsdf = {};
  CHECK_THROWS_WITH(cascade.forward(input), Contains("pure-BSDF"));
  CHECK(cascade.forward(input, {}).sss.defined());
}

TEST_CASE("the illumination network may see a smaller picture") {
  CascadeOptions options = kSmall;
  options.illumination_downscale = 2;
  Cascade cascade(options);
  cascade.initialize(3);
  cascade.set_training(false);
  const NoGradGuard no_grad;
  const CascadeInput input = small_input(64);
  const CascadeOutput out = cascade.forward(input);
  const Tensor smaller = adaptive_avg_pool2d(input.image, 32, 32);
  CHECK(equal(out.illumination, cascade.network("illumination").forward(smaller)));
  CHECK(out.sss.shape() == Shape{kBatch, 7});
  options.illumination_downscale = 0;
  CHECK_THROWS_WITH(Cascade(options), Contains("illumination_downscale"));
}

TEST_CASE("the loss of the last network reaches every parameter of all") {
  Cascade cascade(kSmall);
  cascade.initialize(3);
  const CascadeOutput out = cascade.forward(small_input());
  backward(mean(square(out.reconstruction)));
  for (const NamedTensor& parameter : cascade.named_parameters()) {
    INFO(parameter.name);
    REQUIRE(parameter.tensor.grad().defined());
  }
  // The image enters each network, the gradient flows through normals, depth and illumination alike.
  for (const char* name :
       {"normal.outc.conv.weight", "depth.outc.conv.weight", "illumination.model.14.weight",
        "illumination_decoder.model.0.weight", "sss.scatter_encoder.model.7.weight"}) {
    for (const NamedTensor& parameter : cascade.named_parameters()) {
      if (parameter.name != name) continue;
      double largest = 0.0;
      for (int64_t i = 0; i < parameter.tensor.numel(); ++i) {
        largest = std::max(largest, std::abs(parameter.tensor.grad().at(i)));
      }
      INFO(name);
      CHECK(largest > 0.0);
    }
  }
  cascade.zero_grad();
  for (const NamedTensor& parameter : cascade.named_parameters()) {
    REQUIRE_FALSE(parameter.tensor.grad().defined());
  }
}

TEST_CASE("a network's initial weights are the same alone, in stage 1 and in stage 2") {
  Cascade stage1({.network = kSmall.network, .stage = 1});
  Cascade stage2(kSmall);
  stage1.initialize(5);
  stage2.initialize(5);
  const auto alone = make_network("depth", kSmall.network);
  initialize_network(*alone, "depth", 5);
  for (const auto& [name, tensor] : alone->state_dict()) {
    REQUIRE(equal(tensor, stage1.network("depth").state_dict().at(name)));
    REQUIRE(equal(tensor, stage2.network("depth").state_dict().at(name)));
  }
}

}  // namespace
}  // namespace opaline
