// The optimiser and the schedules at the ends of float32's range.
#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <string>

#include "core/check/array.h"
#include "core/safetensors.h"
#include "nn/optim.h"
#include "nn/schedule.h"

namespace opaline {
namespace {

struct Steps {
  Tensor parameter;
  Adam adam;
  explicit Steps(int64_t count, DType dtype)
      : parameter(Tensor::zeros({count}, dtype).set_requires_grad(true)), adam({{"p", parameter}}) {}

  void step(const Tensor& gradient) {
    parameter.set_grad(gradient.to(parameter.dtype()));
    adam.step();
  }
  Tensor moment(const std::string& name) const { return adam.state_dict().at(name + ".p"); }
};

/// Relative to each element, or to the smallest normal number of float32; infinite where one is not finite
/// and the other is.
double element_error(const Tensor& found, const Tensor& expected) {
  double worst = 0.0;
  for (int64_t i = 0; i < expected.numel(); ++i) {
    const double a = found.at(i), e = expected.at(i);
    if (a == e) continue;
    const double size = std::max(std::abs(e), static_cast<double>(std::numeric_limits<float>::min()));
    check::include_error(worst, std::isfinite(e) ? std::abs(a - e) / size : std::nan(""));
  }
  return worst;
}

Tensor row(const Tensor& table, int64_t i) {
  const int64_t columns = table.size(1);
  Tensor result({columns}, DType::kFloat32);
  for (int64_t j = 0; j < columns; ++j)
    result.data<float>()[j] = static_cast<float>(table.at(i * columns + j));
  return result;
}

TEST_CASE("Adam under gradients from 1e-45 to 3e38 does what PyTorch does") {
  const TensorMap golden =
      load_safetensors(std::string(OPALINE_TEST_DATA) + "/adam_extremes.safetensors").tensors;
  const Tensor& gradients = golden.at("gradients");
  for (const DType dtype : {DType::kFloat32, DType::kFloat64}) {
    const double tolerance = dtype == DType::kFloat32 ? 1e-6 : 1e-13;
    Steps steps(gradients.size(1), dtype);
    for (int64_t step = 0; step < gradients.size(0); ++step) {
      steps.step(row(gradients, step));
      const auto expected = [&](const std::string& name) {
        return golden.at(fmt::format("{}.{}.{}", to_string(dtype), step, name));
      };
      INFO(to_string(dtype) << " step " << step);
      CHECK(element_error(steps.parameter, expected("p")) <= tolerance);
      CHECK(element_error(steps.moment("exp_avg"), expected("exp_avg")) <= tolerance);
      CHECK(element_error(steps.moment("exp_avg_sq"), expected("exp_avg_sq")) <= tolerance);
    }
  }
}

/// The parameter after steps under these gradients, one a step.
double after(std::initializer_list<double> gradients, DType dtype) {
  Steps steps(1, dtype);
  for (const double gradient : gradients) steps.step(Tensor::from({gradient}, {1}));
  return steps.parameter.item();
}

TEST_CASE("Adam in float32 follows float64 wherever the square of a gradient has a place") {
  for (const double g : {1e-30, 1e-20, 1e-12, 1e-8, 1e-4, 1.0, 1e4, 1e10, 1e18, 1e20}) {
    INFO(g);
    CHECK(after({g}, DType::kFloat32) == Approx(after({g}, DType::kFloat64)).epsilon(2e-6));
    CHECK(after({g, -g, g}, DType::kFloat32) == Approx(after({g, -g, g}, DType::kFloat64)).epsilon(2e-6));
  }
}

TEST_CASE("Adam with nothing to go by moves nothing") {
  // v = 0 and m = 0: 0 / (0 + eps).
  CHECK(after({0.0, -0.0, 0.0}, DType::kFloat32) == 0.0);
  // v = 0 because the square of the gradient underflows: eps alone divides. rate * m, 2e-42, has three
  // digits.
  CHECK(after({1e-38}, DType::kFloat32) == Approx(-2e-4 * 1e-38 / 1e-8).epsilon(1e-3));
}

TEST_CASE("a gradient whose square leaves float32 stops its element, as in PyTorch, and no other") {
  Steps steps(2, DType::kFloat32);
  steps.step(Tensor::from({1e30, 1.0}, {2}));
  steps.step(Tensor::from({1.0, 1.0}, {2}));
  CHECK(std::isinf(steps.moment("exp_avg_sq").at(0)));
  CHECK(steps.parameter.at(0) == 0.0);
  CHECK(steps.parameter.at(1) == Approx(-4e-4).epsilon(1e-3));
}

TEST_CASE("a gradient that is not a number shows in its parameter") {
  CHECK(std::isnan(after({std::nan("")}, DType::kFloat32)));
  CHECK(std::isnan(after({std::numeric_limits<double>::infinity()}, DType::kFloat32)));
}

TEST_CASE("the gradient norm of extreme gradients is float64's") {
  NamedTensor p{"p", Tensor::zeros({2})};
  p.tensor.set_requires_grad(true);
  for (const double g : {1e-45, 1e-38, 1e-30, 1e30, 3e38}) {
    const auto single = static_cast<float>(g);
    p.tensor.set_grad(Tensor::from({single, single}, {2}));
    CHECK(gradient_norm({p}) == Approx(std::sqrt(2.0) * static_cast<double>(single)).epsilon(1e-14));
  }
  p.tensor.set_grad(Tensor::zeros({2}));
  CHECK(gradient_norm({p}) == 0.0);
}

TEST_CASE("schedules stay in (0, 1] up to the last step, and fall all the way, however long") {
  for (const int64_t total : {int64_t{1}, int64_t{2}, int64_t{3}, int64_t{1000}, int64_t{1} << 40}) {
    INFO(total);
    const double last = linear_decay_by_step(total - 1, total);
    CHECK(last > 0.0);
    CHECK(linear_decay_by_step(0, total) == 1.0);
    CHECK(linear_decay_by_step(total / 2, total) == 1.0);
    if (total > 2) CHECK(last == Approx(2.0 / static_cast<double>(total)).epsilon(1e-9));
    CHECK(linear_decay_by_step(total, total) == 0.0);
    CHECK(linear_decay_by_step(2 * total, total) == 0.0);
  }
  CHECK(linear_decay_by_step(0, 0) == 1.0);
  for (const int64_t decay : {int64_t{0}, int64_t{1}, int64_t{10}, int64_t{1} << 40}) {
    CHECK(linear_decay_by_epoch(0, 1, decay) == 1.0);
    CHECK(linear_decay_by_epoch(decay, 1, decay) > 0.0);
    CHECK(linear_decay_by_epoch(decay + 1, 1, decay) == 0.0);
  }
}

}  // namespace
}  // namespace opaline
