#include "core/kernels/conv_plan.h"

#include <catch2/catch.hpp>
#include <string>
#include <vector>

#include "core/error.h"

namespace opaline::kernels {
namespace {

ConvShape layer(int64_t n, int64_t size, int64_t in, int64_t out) {
  return {.n = n, .h = size, .w = size, .in = in, .out = out, .kernel_h = 3, .kernel_w = 3, .padding = 1};
}

TEST_CASE("numerics admit algorithms by their error") {
  const ConvShape wide = layer(2, 64, 256, 256);
  for (const ConvPass pass : {ConvPass::kForward, ConvPass::kInputGradient, ConvPass::kWeightGradient}) {
    INFO(to_string(pass));
    CHECK(choose_algorithm(wide, pass, Numerics::kStrict) == (pass == ConvPass::kWeightGradient ? 0 : 2));
    CHECK(choose_algorithm(wide, pass, Numerics::kBalanced) == 4);
    CHECK(choose_algorithm(wide, pass, Numerics::kFast) >= 4);
    // What Winograd cannot do is direct in all of them.
    ConvShape strided = wide, large = wide;
    strided.stride = 2;
    large.kernel_h = large.kernel_w = 9;
    for (const Numerics numerics : {Numerics::kStrict, Numerics::kBalanced, Numerics::kFast}) {
      CHECK(choose_algorithm(strided, pass, numerics) == 0);
      CHECK(choose_algorithm(large, pass, numerics) == 0);
      CHECK(choose_algorithm(layer(0, 64, 256, 256), pass, numerics) == 0);
    }
  }
  // Four blocks of a large kernel.
  ConvShape stem = layer(2, 256, 26, 64);
  stem.kernel_h = stem.kernel_w = 7;
  stem.padding = 3;
  for (const ConvPass pass : {ConvPass::kForward, ConvPass::kInputGradient, ConvPass::kWeightGradient}) {
    CHECK(choose_algorithm(stem, pass, Numerics::kStrict) == 0);
    CHECK(choose_algorithm(stem, pass, Numerics::kBalanced) == 3);
  }
  // A few tiles do not pay for larger transformed filters: of a small image, or where few pixels exist.
  CHECK(choose_algorithm(layer(1, 4, 512, 512), ConvPass::kWeightGradient, Numerics::kBalanced) == 2);
  ConvShape part = layer(2, 32, 512, 512);
  CHECK(choose_algorithm(part, ConvPass::kWeightGradient, Numerics::kBalanced) == 4);
  part.sixteenths = 1;
  CHECK(choose_algorithm(part, ConvPass::kWeightGradient, Numerics::kBalanced) == 2);
}

TEST_CASE("a plan keeps its choices and goes through JSON") {
  ConvPlan plan(Numerics::kBalanced);
  ConvShape mirrored = layer(2, 64, 256, 256);
  mirrored.reflect = true;
  CHECK(plan.outputs(mirrored, ConvPass::kForward) == 4);
  CHECK(plan.outputs(layer(2, 16, 21, 64), ConvPass::kWeightGradient) ==
        choose_algorithm(layer(2, 16, 21, 64), ConvPass::kWeightGradient, Numerics::kBalanced));
  std::string json = plan.to_json();
  CHECK(planned_numerics(json, "plan.json") == Numerics::kBalanced);

  // A choice that was made differently is kept.
  const std::string chosen = "\"forward\": 4";
  REQUIRE(json.find(chosen) != std::string::npos);
  json.replace(json.find(chosen), chosen.size(), "\"forward\": 2");
  ConvPlan resumed(Numerics::kBalanced);
  resumed.load(json, "plan.json");
  CHECK(resumed.outputs(mirrored, ConvPass::kForward) == 2);
  CHECK(resumed.to_json() == json);
  mirrored.reflect = false;
  CHECK(resumed.outputs(mirrored, ConvPass::kForward) == 4);
}

TEST_CASE("a plan that is damaged says so and changes nothing") {
  ConvPlan plan(Numerics::kBalanced);
  plan.outputs(layer(2, 64, 256, 256), ConvPass::kForward);
  const std::string before = plan.to_json();
  const auto refuses = [&](const std::string& json, const std::string& words) {
    INFO(json);
    try {
      plan.load(json, "run/convolutions.json");
      CHECK(false);
    } catch (const Error& error) {
      const std::string message = error.what();
      CHECK(message.find("run/convolutions.json") != std::string::npos);
      CHECK(message.find(words) != std::string::npos);
    }
    CHECK(plan.to_json() == before);
  };
  const auto with = [](const std::string& shape, const std::string& passes) {
    return R"({"numerics": "balanced", "convolutions": {")" + shape + R"(": )" + passes + "}}";
  };
  const std::string shape = to_string(layer(2, 64, 256, 256));
  refuses("", "no plan");
  refuses("[]", "no plan");
  refuses(R"({"numerics": "strict", "convolutions": {}})", "strict");
  refuses(R"({"numerics": "quick", "convolutions": {}})", "quick");
  refuses(with(shape, R"({"forward": 3})"), "tiles of 3");
  refuses(with(shape, R"({"sideways": 4})"), "sideways");
  refuses(with(shape, R"({"forward": "4"})"), "no plan");
  refuses(with("2x64x64x256 -> 256, kernel 7x7, stride 1, padding 3", R"({"forward": 4})"), "tiles of 4");
}

TEST_CASE("a shape goes through text") {
  ConvShape s = layer(2, 9, 21, 64);
  CHECK(parse_conv_shape(to_string(s)) == s);
  s.reflect = true;
  s.stride = 2;
  CHECK(parse_conv_shape(to_string(s)) == s);
  s.sixteenths = 3;
  CHECK(parse_conv_shape(to_string(s)) == s);
  s.reflect = false;
  CHECK(parse_conv_shape(to_string(s)) == s);
  s.sixteenths = 6;  // plans of earlier versions counted eighths
  CHECK(parse_conv_shape("2x9x9x21 -> 64, kernel 3x3, stride 2, padding 1, 3/8 of the pixels") == s);
  for (const std::string& text : std::vector<std::string>{
           "", "2x64x64x256", "2x64x64x256 -> 256, kernel 3x3, stride 1, padding 1 reflected",
           "2x64x64x256 -> 256, kernel 3x3, stride 1, padding 1, 9/8 of the pixels",
           "2x64x64x256 -> 256, kernel 3x3, stride 1, padding 1, 16/16 of the pixels",
           "2x64x64x256 -> 256, kernel 3x3, stride 1, padding 1, 3/12 of the pixels",
           "2x64x64x256 -> 256, kernel 3x3, stride 1, padding 1, 3/16 of the pixels, and more",
           "2x64x64x256 -> 256, kernel 3x3, stride 1, padding 1 mirrored3/8 of the pixels",
           "2x64x64x-1 -> 256, kernel 3x3, stride 1, padding 1"}) {
    INFO(text);
    CHECK_THROWS_AS(parse_conv_shape(text), Error);
  }
}

}  // namespace
}  // namespace opaline::kernels
