// Values at the ends of float32's range, where intermediate results may leave it although the result does not.
#include <catch2/catch.hpp>
#include <cmath>
#include <limits>

#include "core/autograd.h"
#include "core/ops/activation.h"
#include "core/ops/arithmetic.h"

namespace opaline {
namespace {

Tensor leaf(std::initializer_list<double> values, Shape shape) {
  Tensor x = Tensor::from(values, std::move(shape));
  x.set_requires_grad(true);
  return x;
}

TEST_CASE("a quotient's gradient passes over no intermediate infinity") {
  // dy / b is infinite for each; the gradient, -dy a / b^2, is 0 and -1e37.
  const Tensor a = leaf({0.0, 1e-43}, {2}), b = leaf({1e-40, 1e-40}, {2});
  backward(div(a, b), Tensor::from({1.0, 1.0}, {2}));
  CHECK(b.grad().at(0) == 0.0);
  CHECK(b.grad().at(1) == Approx(-1e37).epsilon(1e-2));  // denormals have few digits
}

TEST_CASE("an infinity comes out of gelu's gradient, as out of PyTorch's") {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  const Tensor x = leaf({kInfinity, -kInfinity, 1e30, -1e30}, {4});
  backward(gelu(x), Tensor::full({4}, 1.0));
  CHECK(std::isnan(x.grad().at(0)));
  CHECK(std::isnan(x.grad().at(1)));
  CHECK(x.grad().at(2) == 1.0);
  CHECK(x.grad().at(3) == 0.0);
}

}  // namespace
}  // namespace opaline
