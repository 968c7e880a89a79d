// Whole networks in float64: backward against difference quotients of the forward pass.
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "core/autograd.h"
#include "models/network.h"
#include "tests/pattern.h"

namespace opaline {
namespace {

// At width 4 the decoder's last hidden layer has one channel, and its ReLU may die.
NetworkOptions small_options(std::string_view name) {
  return {.image_size = 32, .width = name == "illumination_decoder" ? 16 : 4, .dtype = DType::kFloat64};
}
constexpr double kTolerance = 1e-6;
constexpr int kMaxDraws = 20;

double dot(const Tensor& a, const Tensor& b) {
  double sum = 0.0;
  for (int64_t i = 0; i < a.numel(); ++i) sum += a.at(i) * b.at(i);
  return sum;
}

// x + scale * direction, in place.
void move(Tensor x, const Tensor& start, const Tensor& direction, double scale) {
  for (int64_t i = 0; i < x.numel(); ++i) {
    x.data<double>()[i] = start.at(i) + scale * direction.at(i);
  }
}

// The gradient's own direction, where the signal is, plus a random one of the same length, so that an error
// in any element shows.
Tensor draw_direction(const Tensor& grad, uint64_t tag) {
  Tensor direction = test::pattern_tensor(grad.shape(), tag);
  const double random_norm = std::sqrt(dot(direction, direction));
  const double grad_norm = std::sqrt(dot(grad, grad));
  for (int64_t i = 0; i < grad.numel(); ++i) {
    double& value = direction.data<double>()[i];
    value = value / random_norm + (grad_norm > 0.0 ? grad.at(i) / grad_norm : 0.0);
  }
  return direction;
}

// Derivative of f along a direction of one leaf. Where a ReLU or a maximum changes its choice between the
// points, quotients of different steps disagree by far more than a smooth function's: then NaN, and the
// caller draws again. The gradient has no part in that decision.
double directional_derivative(const std::function<double()>& f, const Tensor& leaf, const Tensor& direction,
                              double step, double scale) {
  const Tensor start = leaf.clone();
  const auto quotient = [&](double h) {
    move(leaf, start, direction, h);
    const double plus = f();
    move(leaf, start, direction, -h);
    return (plus - f()) / (2.0 * h);
  };
  const double wide = quotient(step);
  const double narrow = quotient(step / 2.0);
  move(leaf, start, direction, 0.0);
  if (!(std::abs(wide - narrow) <= 2e-7 * scale)) return std::nan("");
  return (4.0 * narrow - wide) / 3.0;
}

void check_gradients(std::string_view name, bool training) {
  const NetworkOptions options = small_options(name);
  const auto network = make_network(name, options);
  test::set_pattern_state(*network);
  network->set_training(training);
  const int64_t batch = name == "illumination" || name == "sss" ? 4 : 2;
  Shape shape = {batch, 32, 32, options.input_channels};
  if (name == "sss") shape[3] += 5;
  if (name == "reconstruction") shape[3] = kBsdfChannels + sss_values(options.variant);
  if (name == "illumination_decoder") shape = {batch, illumination_values(options.variant)};
  std::vector<NamedTensor> leaves = network->named_parameters();
  leaves.push_back({"x", test::pattern_tensor(shape, test::kInputTag)});
  Tensor& x = leaves.back().tensor;
  x.set_requires_grad(true);

  const Tensor y = network->forward(x);
  const Tensor cotangent = test::pattern_tensor(y.shape(), test::kCotangentTag);
  backward(y, cotangent);
  const auto loss = [&] {
    const NoGradGuard no_grad;
    const Tensor now = network->forward(x);
    double sum = 0.0;
    for (int64_t i = 0; i < now.numel(); ++i) sum += (now.at(i) - y.at(i)) * cotangent.at(i);
    return sum;
  };
  std::vector<double> norms;
  for (const NamedTensor& leaf : leaves)
    norms.push_back(std::sqrt(dot(leaf.tensor.grad(), leaf.tensor.grad())));
  std::vector<double> sorted = norms;
  std::nth_element(sorted.begin(), sorted.begin() + static_cast<int64_t>(sorted.size() / 2), sorted.end());
  const double typical = sorted[sorted.size() / 2];

  for (size_t i = 0; i < leaves.size(); ++i) {
    // A gradient that is zero in exact arithmetic (a bias before a norm) is measured against a typical one.
    const double scale = std::max(norms[i], 1e-2 * typical);
    double error = std::nan("");
    // The first step changes the loss by about 1e-4, far over rounding, whatever the size of the gradient.
    double step = std::min(1e-4 / scale, 3e-3);
    for (uint64_t draw = 0; draw < kMaxDraws && std::isnan(error); ++draw) {
      const Tensor direction = draw_direction(leaves[i].tensor.grad(), 5000 + 100 * i + draw);
      error = std::abs(directional_derivative(loss, leaves[i].tensor, direction, step, scale) -
                       dot(leaves[i].tensor.grad(), direction)) /
              scale;
      step *= 0.7;
    }
    INFO(name << " " << leaves[i].name << ": relative error " << error << ", gradient norm " << norms[i]);
    CHECK(error <= kTolerance);
  }
}

TEST_CASE("gradients of whole networks are those of difference quotients") {
  for (const std::string_view name : kNetworkNames) {
    for (const bool training : {true, false}) {
      DYNAMIC_SECTION(name << (training ? " train" : " eval")) {
        check_gradients(name, training);
      }
    }
  }
}

}  // namespace
}  // namespace opaline
