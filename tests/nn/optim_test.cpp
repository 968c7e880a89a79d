#include "nn/optim.h"

#include <catch2/catch.hpp>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>
#include <memory>
#include <vector>

#include "core/parallel.h"
#include "core/random.h"
#include "nn/pattern.h"
#include "nn/schedule.h"

namespace opaline {
namespace {

using Catch::Contains;

NamedTensor parameter(const std::string& name, const Tensor& value) {
  NamedTensor result{name, value};
  result.tensor.set_requires_grad(true);
  return result;
}

Tensor random_tensor(const Shape& shape, uint32_t sample, DType dtype) {
  Random random(2, Purpose::kTest, 0, sample);
  Tensor result(shape, DType::kFloat64);
  for (double& value : result.values<double>()) value = random.normal();
  return result.to(dtype);
}

TEST_CASE("Adam follows its formula step by step") {
  const AdamOptions options{.learning_rate = 0.1, .beta1 = 0.5, .beta2 = 0.9, .eps = 1e-3};
  NamedTensor p = parameter("p", Tensor::from({1.0}, {1}, DType::kFloat64));
  Adam adam({p}, options);
  double value = 1.0, m = 0.0, v = 0.0;
  for (int t = 1; t <= 5; ++t) {
    const double gradient = std::sin(t);
    const double factor = t < 3 ? 1.0 : 0.5;
    p.tensor.set_grad(Tensor::from({gradient}, {1}, DType::kFloat64));
    adam.step(factor);
    m = 0.5 * m + 0.5 * gradient;
    v = 0.9 * v + 0.1 * gradient * gradient;
    const double m_hat = m / (1.0 - std::pow(0.5, t));
    const double v_hat = v / (1.0 - std::pow(0.9, t));
    value -= 0.1 * factor * m_hat / (std::sqrt(v_hat) + 1e-3);
    CHECK(p.tensor.item() == Approx(value).epsilon(1e-13));
  }
  CHECK(adam.step_count() == 5);
  CHECK(adam.state_dict().at("exp_avg.p").item() == Approx(m).epsilon(1e-13));
  CHECK(adam.state_dict().at("exp_avg_sq.p").item() == Approx(v).epsilon(1e-13));
}

TEST_CASE("ten steps of Adam are PyTorch's") {
  const TensorMap golden =
      load_safetensors(std::string(OPALINE_TEST_DATA) + "/adam_steps.safetensors").tensors;
  // PyTorch fuses its arithmetic differently in float32: a few units in the last place over ten steps.
  for (const auto& [dtype, tolerance] :
       std::map<DType, double>{{DType::kFloat64, 1e-14}, {DType::kFloat32, 2e-6}}) {
    const std::string prefix = to_string(dtype) + ".";
    const auto check = [&](const std::string& name, const Tensor& found) {
      const Tensor& expected = golden.at(prefix + name);
      REQUIRE(found.shape() == expected.shape());
      for (int64_t i = 0; i < found.numel(); ++i) {
        INFO(prefix << name << "[" << i << "]: " << found.at(i) << ", expected " << expected.at(i));
        REQUIRE(std::abs(found.at(i) - expected.at(i)) <= tolerance);
      }
    };
    std::vector<NamedTensor> parameters;
    for (const char* name : {"a", "b", "c"}) {
      const Shape& shape = golden.at(prefix + "0." + name).shape();
      parameters.push_back(parameter(name, test::pattern_tensor(shape, parameters.size(), 1.0, 0.0, dtype)));
    }
    Adam adam(parameters, {.learning_rate = 2e-2, .beta1 = 0.5});
    for (uint64_t step = 0; step < 10; ++step) {
      for (uint64_t tag = 0; tag < parameters.size(); ++tag) {
        Tensor& tensor = parameters[tag].tensor;
        const bool rests = tag == 2 && step >= 3 && step <= 5;
        tensor.set_grad(
            rests ? Tensor() : test::pattern_tensor(tensor.shape(), 100 * (step + 1) + tag, 1.0, 0.0, dtype));
      }
      adam.step(linear_decay_by_step(static_cast<int64_t>(step), 10));
      for (const auto& [name, tensor, initial] : parameters) check(fmt::format("{}.{}", step, name), tensor);
    }
    for (const auto& [name, tensor] : adam.state_dict()) {
      if (name != "step_count") check(name, tensor);
    }
  }
}

TEST_CASE("Adam leaves a parameter without gradient alone, its step count too") {
  NamedTensor moving = parameter("moving", Tensor::full({3}, 1.0));
  NamedTensor resting = parameter("resting", Tensor::full({3}, 1.0));
  Adam adam({moving, resting});
  moving.tensor.set_grad(Tensor::full({3}, 1.0));
  adam.step();
  CHECK(moving.tensor.at(0) == Approx(1.0 - 2e-4).epsilon(1e-6));
  CHECK(resting.tensor.at(0) == 1.0);
  CHECK(adam.state_dict().at("step.moving").item() == 1.0);
  CHECK(adam.state_dict().at("step.resting").item() == 0.0);
  adam.zero_grad();
  CHECK_FALSE(moving.tensor.grad().defined());
}

TEST_CASE("Adam goes on from a saved state with the same bits, for any number of threads") {
  const Shape shape = {300, 700};
  const int before = num_threads();
  const auto run = [&](int threads, bool interrupted) {
    set_num_threads(threads);
    NamedTensor p = parameter("p", random_tensor(shape, 0, DType::kFloat32));
    auto adam = std::make_unique<Adam>(std::vector{p});
    for (uint32_t t = 1; t <= 4; ++t) {
      if (interrupted && t == 3) {
        TensorMap state;
        for (const auto& [name, tensor] : adam->state_dict()) state[name] = tensor.clone();
        adam = std::make_unique<Adam>(std::vector{p});
        adam->load_state_dict(state);
        CHECK(adam->step_count() == 2);
      }
      p.tensor.set_grad(random_tensor(shape, t, DType::kFloat32));
      adam->step(0.5);
    }
    return p.tensor;
  };
  const Tensor plain = run(1, false);
  for (const Tensor& other : {run(3, false), run(2, true)}) {
    CHECK(std::memcmp(plain.bytes(), other.bytes(), static_cast<size_t>(plain.byte_size())) == 0);
  }
  set_num_threads(before);
}

TEST_CASE("Adam refuses a state that is not its own") {
  Adam adam({parameter("a", Tensor::zeros({2})), parameter("b", Tensor::zeros({3}))});
  Adam other({parameter("a", Tensor::zeros({4})), parameter("c", Tensor::zeros({3}))});
  CHECK_THROWS_WITH(adam.load_state_dict(other.state_dict(), "optimizer.safetensors"),
                    Contains("[optimizer.safetensors]") && Contains("missing: exp_avg.b (3)") &&
                        Contains("extra: step.c") && Contains("shape: exp_avg_sq.a is 4, expected 2"));
  TensorMap state = adam.state_dict();
  state["exp_avg.a"] = Tensor::full({2}, std::numeric_limits<double>::quiet_NaN());
  CHECK_THROWS_WITH(adam.load_state_dict(state), Contains("not finite: exp_avg.a"));
  CHECK_THROWS_WITH(Adam({parameter("a", Tensor::zeros({2})), parameter("a", Tensor::zeros({2}))}),
                    Contains("two tensors named"));
}

TEST_CASE("the gradient norm is over all gradients, and not finite where one is not") {
  NamedTensor a = parameter("a", Tensor::zeros({2}));
  NamedTensor b = parameter("b", Tensor::zeros({100000}, DType::kFloat64));
  NamedTensor none = parameter("none", Tensor::zeros({5}));
  a.tensor.set_grad(Tensor::from({3.0, 4.0}, {2}));
  b.tensor.set_grad(Tensor::full({100000}, 0.12, DType::kFloat64));
  CHECK(gradient_norm({a, b, none}) == Approx(std::sqrt(25.0 + 1440.0)).epsilon(1e-12));
  a.tensor.set_grad(Tensor::from({3.0, std::numeric_limits<double>::quiet_NaN()}, {2}));
  CHECK(std::isnan(gradient_norm({a, b})));
}

TEST_CASE("the rate is constant for the first half of the steps, then falls to almost nothing") {
  CHECK(linear_decay_by_step(0, 1000) == 1.0);
  CHECK(linear_decay_by_step(500, 1000) == 1.0);
  CHECK(linear_decay_by_step(501, 1000) == Approx(0.998).epsilon(1e-12));
  CHECK(linear_decay_by_step(750, 1000) == Approx(0.5).epsilon(1e-12));
  CHECK(linear_decay_by_step(999, 1000) == Approx(0.002).epsilon(1e-9));
  CHECK(linear_decay_by_step(2000, 1000) == 0.0);
  CHECK(linear_decay_by_step(0, 1) == 1.0);
  CHECK(linear_decay_by_step(4, 7) == Approx(1.0 - 0.5 / 3.5).epsilon(1e-12));
}

TEST_CASE("the rate of an epoch is the release's") {
  for (const int64_t epoch : {0, 8, 9}) CHECK(linear_decay_by_epoch(epoch) == 1.0);
  CHECK(linear_decay_by_epoch(10) == Approx(10.0 / 11.0).epsilon(1e-12));
  CHECK(linear_decay_by_epoch(19) == Approx(1.0 / 11.0).epsilon(1e-12));
  CHECK(linear_decay_by_epoch(1, 1, 3) == Approx(0.75).epsilon(1e-12));
}

}  // namespace
}  // namespace opaline
