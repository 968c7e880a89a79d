// Each layer on small numbers worked out by hand or from its definition; whole networks are compared with
// PyTorch in tests/models.
#include <catch2/catch.hpp>
#include <cmath>
#include <numeric>
#include <string>
#include <vector>

#include "core/autograd.h"
#include "core/ops/activation.h"
#include "core/ops/arithmetic.h"
#include "core/ops/reduce.h"
#include "core/ops/shape.h"
#include "core/ops/unary.h"
#include "core/random.h"
#include "nn/attention.h"
#include "nn/conv.h"
#include "nn/linear.h"
#include "nn/norm.h"
#include "nn/residual.h"
#include "nn/sequential.h"

namespace opaline {
namespace {

constexpr DType kWide = DType::kFloat64;

Tensor random_tensor(const Shape& shape, uint32_t sample) {
  Random random(1, Purpose::kTest, 0, sample);
  Tensor result(shape, kWide);
  for (double& value : result.values<double>()) value = random.uniform(-1.0, 1.0);
  return result;
}

void check_close(const Tensor& found, const Tensor& expected, double tolerance = 1e-12) {
  REQUIRE(found.shape() == expected.shape());
  for (int64_t i = 0; i < found.numel(); ++i) {
    INFO("element " << i << ": " << found.at(i) << ", expected " << expected.at(i));
    REQUIRE(std::abs(found.at(i) - expected.at(i)) <= tolerance);
  }
}

void set(Module& module, const std::string& name, const Tensor& value) {
  module.state_dict().at(name).copy_from(value);
}

TEST_CASE("Conv2d") {
  Conv2d layer({.in = 1, .out = 1, .kernel = 3, .padding = 1, .dtype = kWide});
  set(layer, "weight", Tensor::full({1, 1, 3, 3}, 1.0, kWide));
  set(layer, "bias", Tensor::full({1}, 0.5, kWide));
  const Tensor x = Tensor::from({1, 2, 3, 4}, {1, 2, 2, 1}, kWide);
  check_close(layer.forward(x), Tensor::from({10.5, 10.5, 10.5, 10.5}, {1, 2, 2, 1}, kWide));
  CHECK_THROWS_AS(layer.forward(Tensor::zeros({1, 2, 2, 3}, kWide)), Error);

  // Mirrored without the border: each row and column appears as 2 1 2 1.
  Conv2d reflecting(
      {.in = 1, .out = 1, .padding = 1, .padding_mode = Padding::kReflect, .bias = false, .dtype = kWide});
  CHECK(reflecting.named_parameters().size() == 1);
  set(reflecting, "weight", Tensor::full({1, 1, 3, 3}, 1.0, kWide));
  check_close(reflecting.forward(x), Tensor::from({27, 24, 21, 18}, {1, 2, 2, 1}, kWide));
}

TEST_CASE("ConvTranspose2d doubles the size") {
  ConvTranspose2d layer({.in = 2, .out = 3, .dtype = kWide});
  CHECK(layer.state_dict().at("weight").shape() == Shape{2, 3, 4, 4});
  set(layer, "weight", Tensor::full({2, 3, 4, 4}, 1.0, kWide));
  // A single pixel reaches 4 x 4 outputs, of which padding 1 leaves the inner 2 x 2.
  const Tensor y = layer.forward(Tensor::from({1.0, 2.0}, {1, 1, 1, 2}, kWide));
  check_close(y, Tensor::full({1, 2, 2, 3}, 3.0, kWide));
}

TEST_CASE("Linear and FcStack") {
  Linear layer({.in = 2, .out = 1, .dtype = kWide});
  set(layer, "weight", Tensor::from({2.0, -1.0}, {1, 2}, kWide));
  set(layer, "bias", Tensor::from({0.25}, {1}, kWide));
  check_close(layer.forward(Tensor::from({1.0, 3.0, -1.0, 0.0}, {2, 2}, kWide)),
              Tensor::from({-0.75, -1.75}, {2, 1}, kWide));

  FcStack stack({.widths = {3, 5, 2}, .activation = relu, .dtype = kWide});
  initialize(stack, 1);
  const TensorMap state = stack.state_dict();
  CHECK(state.at("fc1.weight").shape() == Shape{5, 3});
  CHECK(state.at("fc2.weight").shape() == Shape{2, 5});
  const Tensor x = random_tensor({4, 3}, 1);
  const Tensor hidden = relu(linear(x, state.at("fc1.weight"), state.at("fc1.bias")));
  check_close(stack.forward(x), linear(hidden, state.at("fc2.weight"), state.at("fc2.bias")));
  CHECK_THROWS_AS(FcStack({.widths = {3}, .activation = relu}), Error);
}

TEST_CASE("BatchNorm normalises by the batch while training and by running statistics otherwise") {
  BatchNorm layer({.channels = 1, .dtype = kWide});
  const Tensor x = Tensor::from({1.0, 2.0, 3.0, 6.0}, {4, 1}, kWide);  // mean 3, variance 3.5 (14/3 unbiased)
  const double scale = 1.0 / std::sqrt(3.5 + 1e-5);
  check_close(layer.forward(x), Tensor::from({-2 * scale, -scale, 0.0, 3 * scale}, {4, 1}, kWide));
  const TensorMap state = layer.state_dict();
  CHECK(state.at("running_mean").item() == Approx(0.3).epsilon(1e-12));
  CHECK(state.at("running_var").item() == Approx(0.9 + 0.1 * 14.0 / 3.0).epsilon(1e-12));
  CHECK(state.at("num_batches_tracked").item() == 1.0);

  layer.set_training(false);
  const double running = 1.0 / std::sqrt(0.9 + 0.1 * 14.0 / 3.0 + 1e-5);
  check_close(layer.forward(Tensor::from({1.3}, {1, 1}, kWide)), Tensor::from({running}, {1, 1}, kWide));
  CHECK(layer.state_dict().at("num_batches_tracked").item() == 1.0);

  layer.set_training(true);
  CHECK_THROWS_WITH(layer.forward(Tensor::zeros({1, 1}, kWide)), Catch::Contains("single sample"));
  CHECK_NOTHROW(layer.forward(Tensor::zeros({1, 1, 1, 1}, kWide)));
}

TEST_CASE("InstanceNorm and LayerNorm") {
  InstanceNorm plain({.channels = 2, .dtype = kWide});
  CHECK(plain.named_state().empty());
  const Tensor y = plain.forward(random_tensor({2, 4, 4, 2}, 2));
  check_close(mean(mean(y, 1), 1), Tensor::zeros({2, 2}, kWide));
  check_close(mean(mean(square(y), 1), 1), Tensor::full({2, 2}, 1.0, kWide), 1e-3);  // eps is in the variance

  InstanceNorm affine_norm({.channels = 2, .affine = true, .dtype = kWide});
  set(affine_norm, "weight", Tensor::from({2.0, 3.0}, {2}, kWide));
  set(affine_norm, "bias", Tensor::from({1.0, -1.0}, {2}, kWide));
  const Tensor x = random_tensor({2, 4, 4, 2}, 3);
  check_close(affine_norm.forward(x), add(mul(plain.forward(x), Tensor::from({2.0, 3.0}, {2}, kWide)),
                                          Tensor::from({1.0, -1.0}, {2}, kWide)));

  LayerNorm layer({.channels = 3, .eps = 1e-6, .dtype = kWide});
  const double scale = 1.0 / std::sqrt(2.0 / 3.0 + 1e-6);
  check_close(layer.forward(Tensor::from({1.0, 2.0, 3.0}, {1, 1, 3}, kWide)),
              Tensor::from({-scale, 0.0, scale}, {1, 1, 3}, kWide));
}

// Attention by its definition, one query at a time.
Tensor naive_attention(const TensorMap& state, const Tensor& x, int64_t heads) {
  const auto project = [&](const std::string& name, const Tensor& t) {
    return linear(t, state.at(name + ".weight"), state.at(name + ".bias"));
  };
  const Tensor q = project("query", x), k = project("key", x), v = project("value", x);
  const int64_t batch = x.size(0), tokens = x.size(1), channels = x.size(2), depth = channels / heads;
  Tensor mixed = Tensor::zeros(x.shape(), kWide);
  const auto index = [&](int64_t n, int64_t t, int64_t c) { return (n * tokens + t) * channels + c; };
  for (int64_t n = 0; n < batch; ++n) {
    for (int64_t h = 0; h < heads; ++h) {
      for (int64_t t = 0; t < tokens; ++t) {
        std::vector<double> weight(static_cast<size_t>(tokens));
        for (int64_t s = 0; s < tokens; ++s) {
          double score = 0.0;
          for (int64_t c = h * depth; c < (h + 1) * depth; ++c)
            score += q.at(index(n, t, c)) * k.at(index(n, s, c));
          weight[static_cast<size_t>(s)] = std::exp(score / std::sqrt(static_cast<double>(depth)));
        }
        const double total = std::accumulate(weight.begin(), weight.end(), 0.0);
        for (int64_t c = h * depth; c < (h + 1) * depth; ++c) {
          double sum = 0.0;
          for (int64_t s = 0; s < tokens; ++s)
            sum += weight[static_cast<size_t>(s)] / total * v.at(index(n, s, c));
          mixed.data<double>()[index(n, t, c)] = sum;
        }
      }
    }
  }
  return project("out", mixed);
}

TEST_CASE("SelfAttention is its definition") {
  SelfAttention layer({.channels = 12, .heads = 3, .dtype = kWide});
  uint32_t sample = 10;
  for (const auto& [name, tensor] : layer.state_dict()) {
    set(layer, name, random_tensor(tensor.shape(), sample++));
  }
  const Tensor x = random_tensor({2, 5, 12}, 4);
  check_close(layer.forward(x), naive_attention(layer.state_dict(), x, 3), 1e-11);
  CHECK_THROWS_WITH(SelfAttention({.channels = 12, .heads = 5}), Catch::Contains("12 channels"));
}

TEST_CASE("TransformerBlock adds attention, then the MLP, each of the normalised input") {
  TransformerBlock block({.channels = 8, .heads = 2, .mlp_channels = 16, .dtype = kWide});
  initialize(block, 4);
  std::vector<std::string> names;
  for (const NamedTensor& parameter : block.named_parameters()) names.push_back(parameter.name);
  CHECK(names.front() == "attention_norm.weight");
  CHECK(names.back() == "attn.out.bias");
  CHECK(block.state_dict().at("ffn.fc1.weight").shape() == Shape{16, 8});

  // With silent outputs both branches vanish and the block is the identity.
  for (const char* name : {"attn.out.weight", "ffn.fc2.weight"}) block.state_dict().at(name).fill(0.0);
  const Tensor x = random_tensor({1, 3, 8}, 5);
  check_close(block.forward(x), x);
  block.state_dict().at("ffn.fc2.bias").fill(0.5);
  block.state_dict().at("attn.out.bias").fill(0.25);
  check_close(block.forward(x), affine(x, 1.0, 0.75));
}

TEST_CASE("ResidualBlock adds to its input") {
  ResidualBlock block({.channels = 2, .dtype = kWide});
  initialize(block, 4);
  CHECK(block.state_dict().contains("conv_block.1.weight"));
  CHECK(block.state_dict().contains("conv_block.6.running_var"));
  const Tensor x = random_tensor({2, 4, 4, 2}, 6);
  block.state_dict().at("conv_block.6.weight").fill(0.0);
  check_close(block.forward(x), x);
  block.state_dict().at("conv_block.6.bias").fill(0.5);
  check_close(block.forward(x), affine(x, 1.0, 0.5));
}

TEST_CASE("Sequential numbers every step") {
  Sequential sequence;
  sequence.skip();
  sequence.add<Linear>(LinearConfig{.in = 2, .out = 2, .dtype = kWide});
  sequence.add_function(relu);
  sequence.add<Linear>(LinearConfig{.in = 2, .out = 1, .dtype = kWide});
  CHECK(sequence.state_dict().contains("1.weight"));
  CHECK(sequence.state_dict().contains("3.bias"));
  set(sequence, "1.weight", Tensor::from({1.0, 0.0, 0.0, -1.0}, {2, 2}, kWide));
  set(sequence, "3.weight", Tensor::from({1.0, 10.0}, {1, 2}, kWide));
  check_close(sequence.forward(Tensor::from({3.0, 5.0, -3.0, -5.0}, {2, 2}, kWide)),
              Tensor::from({3.0, 50.0}, {2, 1}, kWide));
}

}  // namespace
}  // namespace opaline
