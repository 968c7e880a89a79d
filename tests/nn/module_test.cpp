#include "nn/module.h"

#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "nn/linear.h"
#include "nn/norm.h"
#include "nn/sequential.h"

namespace opaline {
namespace {

using Catch::Contains;

// One of everything: own parameter, own buffer, children two deep.
class Sample : public Module {
 public:
  explicit Sample(DType dtype = DType::kFloat32) : dtype_(dtype) {
    body_.add<Linear>(LinearConfig{.in = 3, .out = 2, .dtype = dtype_});
    body_.skip();
    body_.add<BatchNorm>(BatchNormConfig{.channels = 2, .scale = kBatchNorm2dScale, .dtype = dtype_});
  }
  Sequential& body() { return body_; }

 private:
  DType dtype_;
  Sequential& body_ = add_child<Sequential>("body");
  Tensor gain_ = add_parameter("gain", {4}, dtype_, {.mean = 2.0});
  Tensor count_ = add_buffer("count", Tensor::zeros({}, DType::kInt64));
};

std::vector<std::string> names(const std::vector<NamedTensor>& entries) {
  std::vector<std::string> result;
  for (const NamedTensor& entry : entries) result.push_back(entry.name);
  return result;
}

TensorMap cloned(const TensorMap& state) {
  TensorMap result;
  for (const auto& [name, tensor] : state) result[name] = tensor.clone();
  return result;
}

TEST_CASE("state is named and ordered as PyTorch's: own before children, parameters before buffers") {
  const Sample module;
  using Names = std::vector<std::string>;
  CHECK(names(module.named_parameters()) ==
        Names{"gain", "body.0.weight", "body.0.bias", "body.2.weight", "body.2.bias"});
  CHECK(names(module.named_buffers()) ==
        Names{"count", "body.2.running_mean", "body.2.running_var", "body.2.num_batches_tracked"});
  CHECK(names(module.named_state()) == Names{"gain", "count", "body.0.weight", "body.0.bias", "body.2.weight",
                                             "body.2.bias", "body.2.running_mean", "body.2.running_var",
                                             "body.2.num_batches_tracked"});
  CHECK(module.parameter_count() == 4 + 6 + 2 + 2 + 2);
}

TEST_CASE("a loaded state is the saved one, in either floating type") {
  Sample source;
  initialize(source, 1);
  Sample same, wide(DType::kFloat64);
  same.load_state_dict(source.state_dict());
  wide.load_state_dict(source.state_dict());
  for (const auto& [name, tensor] : source.state_dict()) {
    const Tensor in_same = same.state_dict().at(name);
    const Tensor in_wide = wide.state_dict().at(name);
    CHECK(in_same.dtype() == tensor.dtype());
    CHECK(in_wide.dtype() == (tensor.is_floating() ? DType::kFloat64 : DType::kInt64));
    for (int64_t i = 0; i < tensor.numel(); ++i) {
      REQUIRE(in_same.at(i) == tensor.at(i));
      REQUIRE(in_wide.at(i) == tensor.at(i));
    }
  }
}

TEST_CASE("a state that does not fit is refused with the full difference, and nothing changes") {
  Sample source, target;
  initialize(source, 1);
  initialize(target, 2);
  const double before = target.state_dict().at("body.0.weight").at(0);
  TensorMap state = source.state_dict();
  state.erase("body.0.bias");
  state["body.1.weight"] = Tensor::zeros({2, 2});
  state["gain"] = Tensor::zeros({3});
  state["count"] = Tensor::zeros({});
  CHECK_THROWS_WITH(target.load_state_dict(state, {.source = "w.safetensors"}),
                    Contains("[w.safetensors]") && Contains("4 differences in 9 expected tensors") &&
                        Contains("missing: body.0.bias (2)") && Contains("extra: body.1.weight (2x2)") &&
                        Contains("shape: gain is 3, expected 4") &&
                        Contains("type: count is float32, expected int64"));
  CHECK(target.state_dict().at("body.0.weight").at(0) == before);
}

TEST_CASE("values that are not finite are refused unless forced") {
  Sample source, target;
  for (const double bad :
       {std::numeric_limits<double>::quiet_NaN(), std::numeric_limits<double>::infinity()}) {
    TensorMap state = cloned(source.state_dict());
    state["body.2.running_var"].fill(bad);
    CHECK_THROWS_WITH(target.load_state_dict(state), Contains("not finite: body.2.running_var"));
    CHECK(target.state_dict().at("body.2.running_var").at(0) == 1.0);
  }
  TensorMap state = cloned(source.state_dict());
  state["gain"].fill(std::numeric_limits<double>::infinity());
  target.load_state_dict(state, {.allow_non_finite = true});
  CHECK(std::isinf(target.state_dict().at("gain").at(0)));
}

TEST_CASE("modes and gradients reach the children") {
  Sample module;
  CHECK(module.training());
  module.set_training(false);
  CHECK_FALSE(module.body().training());
  for (const NamedTensor& parameter : module.named_parameters()) CHECK(parameter.tensor.requires_grad());
  module.set_requires_grad(false);
  for (const NamedTensor& parameter : module.named_parameters())
    CHECK_FALSE(parameter.tensor.requires_grad());
  for (const NamedTensor& buffer : module.named_buffers()) CHECK_FALSE(buffer.tensor.requires_grad());
}

TEST_CASE("initial values have the asked mean and deviation, and each parameter a stream of its own") {
  class Pair : public Module {
    Tensor a_ = add_parameter("a", {20000}, DType::kFloat64, {.mean = 1.0, .deviation = 0.02});
    Tensor b_ = add_parameter("b", {20000}, DType::kFloat64, {.mean = 1.0, .deviation = 0.02});
    Tensor c_ = add_parameter("c", {5}, DType::kFloat64, {.mean = 0.5});
  };
  Pair module;
  initialize(module, 7);
  const TensorMap state = module.state_dict();
  double mean = 0.0, square = 0.0, cross = 0.0;
  for (int64_t i = 0; i < 20000; ++i) {
    const double a = state.at("a").at(i) - 1.0;
    mean += a / 20000;
    square += a * a / 20000;
    cross += a * (state.at("b").at(i) - 1.0) / 20000;
  }
  // Five standard errors each.
  CHECK(std::abs(mean) < 5 * 0.02 / std::sqrt(20000.0));
  CHECK(std::abs(std::sqrt(square) - 0.02) < 5 * 0.02 / std::sqrt(40000.0));
  CHECK(std::abs(cross) < 5 * 0.0004 / std::sqrt(20000.0));
  CHECK(state.at("c").at(4) == 0.5);

  Pair shifted;
  initialize(shifted, 7, 1);
  CHECK(shifted.state_dict().at("a").at(0) == state.at("b").at(0));
}

}  // namespace
}  // namespace opaline
