// Whole networks, small, on inputs that float32 finds hard: forward and backward against float64, and what is
// no number against PyTorch.
#include <catch2/catch.hpp>
#include <cmath>
#include <functional>
#include <limits>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "core/autograd.h"
#include "core/numerics.h"
#include "core/parallel.h"
#include "core/safetensors.h"
#include "models/check.h"
#include "nn/pattern.h"

namespace opaline {
namespace {

// With what they multiply the bound of an output's error by.
const std::map<Numerics, double> kNumerics = {
    {Numerics::kStrict, 1.0}, {Numerics::kBalanced, 3.0}, {Numerics::kFast, 30.0}};

struct Input {
  std::string name;
  std::function<double(double)> of_pattern;  ///< element by element, from numbers in (-1, 1)
  double output_bound;                       ///< of relative errors
  double gradient_bound = 3e-2;  ///< a ReLU or a maximum that chooses differently decides, not the arithmetic
};

const std::vector<Input>& inputs() {
  static const std::vector<Input> list = {
      {"pattern", [](double v) { return v; }, 1e-5},
      {"tiny", [](double v) { return 1e-30 * v; }, 1e-5},
      {"huge", [](double v) { return 1e30 * v; }, 1e-5},
      {"denormal", [](double v) { return 1e-40 * v; }, 1e-5},
      {"constant", [](double) { return 0.7; }, 1e-5},
      {"zeros", [](double v) { return v < 0.0 ? -0.0 : 0.0; }, 1e-5},
      // A convolution's result has the offset too, and its rounding: what a norm leaves has lost three
      // digits.
      {"offset", [](double v) { return 1e3 + v; }, 1e-2, 0.8},
  };
  return list;
}

/// Output and gradients: of the input "x" and of every parameter.
struct Pass {
  Tensor y;
  std::map<std::string, Tensor> gradients;
};

Pass run(std::string_view name, bool training, const Tensor& input, DType dtype) {
  NetworkOptions options = small_network_options(name);
  options.dtype = dtype;
  const auto network = make_network(name, options);
  test::set_pattern_state(*network);
  network->set_training(training);
  Tensor x = input.to(dtype).clone();
  x.set_requires_grad(true);
  Pass pass;
  pass.y = network->forward(x);
  backward(pass.y, test::pattern_tensor(pass.y.shape(), test::kCotangentTag, 1.0, 0.0, dtype));
  pass.gradients["x"] = x.grad();
  for (const NamedTensor& p : network->named_parameters()) pass.gradients[p.name] = p.tensor.grad();
  return pass;
}

Tensor pattern_input(std::string_view name) {
  const bool few = name == "normal" || name == "depth" || name == "reconstruction";
  return test::pattern_tensor(network_input_shape(name, few ? 2 : 8, small_network_options(name)),
                              test::kInputTag);
}

double norm(const Tensor& tensor) {
  double squares = 0.0;
  for (int64_t i = 0; i < tensor.numel(); ++i) squares += tensor.at(i) * tensor.at(i);
  return std::sqrt(squares);
}

/// |a - b| / |b|, of |b| at least `floor`; NaN where a is not finite.
double error(const Tensor& a, const Tensor& b, double floor = 0.0) {
  double squares = 0.0;
  for (int64_t i = 0; i < b.numel(); ++i) squares += std::pow(a.at(i) - b.at(i), 2.0);
  const double smallest = std::numeric_limits<float>::min();
  return std::isfinite(squares) ? std::sqrt(squares) / std::max({norm(b), floor, smallest}) : std::nan("");
}

void check_near(const Pass& narrow, const Pass& wide, const Input& input, double factor) {
  CHECK(error(narrow.y, wide.y) <= factor * input.output_bound);
  // A gradient that is zero in exact arithmetic (of a bias before a norm, of weights of a constant image) is
  // measured by the largest.
  double largest = 0.0;
  for (const auto& [key, gradient] : wide.gradients) largest = std::max(largest, norm(gradient));
  for (const auto& [key, gradient] : wide.gradients) {
    INFO(key);
    const double floor = key == "x" ? 0.0 : 1e-3 * largest;
    CHECK(error(narrow.gradients.at(key), gradient, floor) <= input.gradient_bound);
  }
}

TEST_CASE("networks in float32 are near float64 under stress") {
  const ThreadsGuard one_thread(1);
  for (const std::string_view name : kNetworkNames) {
    for (const bool training : {true, false}) {
      for (const Input& input : inputs()) {
        Tensor x = pattern_input(name);
        for (double& v : x.values<double>()) v = static_cast<double>(static_cast<float>(input.of_pattern(v)));
        const NumericsGuard strict(Numerics::kStrict);
        const Pass wide = run(name, training, x, DType::kFloat64);
        for (const auto& [numerics, factor] : kNumerics) {
          const NumericsGuard guard(numerics);
          INFO(name << (training ? " train " : " eval ") << input.name << " " << to_string(numerics));
          check_near(run(name, training, x, DType::kFloat32), wide, input, factor);
        }
      }
    }
  }
}

int64_t count_non_finite(const Tensor& tensor) {
  int64_t count = 0;
  for (int64_t i = 0; i < tensor.numel(); ++i) count += std::isfinite(tensor.at(i)) ? 0 : 1;
  return count;
}

/// `counts`: PyTorch's, of the output, the input's gradient and the parameters' gradients in order.
void check_surfaces(std::string_view name, bool training, double value, std::span<const int64_t> counts) {
  Tensor x = pattern_input(name);
  // One element of the second image, in the middle of its second channel.
  const int64_t channels = x.size(-1), values = x.numel() / x.size(0);
  const int64_t within = x.dim() == 4 ? (x.size(1) / 2 * x.size(2) + x.size(2) / 2) * channels + 1 : 1;
  x.data<double>()[values + within] = value;
  for (const DType dtype : {DType::kFloat32, DType::kFloat64}) {
    const Pass pass = run(name, training, x, dtype);
    CHECK(count_non_finite(pass.y) == counts[0]);
    CHECK(count_non_finite(pass.gradients.at("x")) >= counts[1]);
    size_t i = 2;
    for (const NamedTensor& parameter : make_network(name, small_network_options(name))->named_parameters()) {
      INFO(parameter.name);
      CHECK(count_non_finite(pass.gradients.at(parameter.name)) >= counts[i++]);
    }
    CHECK(i == counts.size());
    // In evaluation an image does not see another.
    if (training) continue;
    const int64_t outputs = pass.y.numel() / pass.y.size(0);
    for (int64_t k = 0; k < pass.y.numel(); ++k) {
      if (k / outputs != 1) REQUIRE(std::isfinite(pass.y.at(k)));
    }
  }
}

TEST_CASE("one value that is not a number comes out where it comes out of PyTorch") {
  const ThreadsGuard one_thread(1);
  const TensorMap golden =
      load_safetensors(std::string(OPALINE_TEST_DATA) + "/non_finite.safetensors").tensors;
  for (const std::string_view name : kNetworkNames) {
    for (const bool training : {true, false}) {
      for (const auto& [kind, value] : std::map<std::string, double>{
               {"nan", std::nan("")}, {"infinity", std::numeric_limits<double>::infinity()}}) {
        for (const auto& [numerics, factor] : kNumerics) {
          const NumericsGuard guard(numerics);
          const std::string key = fmt::format("{}.{}.{}", name, training ? "train" : "eval", kind);
          INFO(key << " " << to_string(numerics));
          check_surfaces(name, training, value, golden.at(key).values<int64_t>());
        }
      }
    }
  }
}

}  // namespace
}  // namespace opaline
