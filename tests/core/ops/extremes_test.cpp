// Values at the ends of float32's range, where intermediate results may leave it although the result does
// not.
#include <catch2/catch.hpp>
#include <cmath>
#include <limits>

#include "core/autograd.h"
#include "core/ops/activation.h"
#include "core/ops/arithmetic.h"
#include "core/ops/norm.h"

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

/// Float32 gradient of batch_norm's input, against float64.
double batch_norm_gradient_error(std::initializer_list<double> values) {
  const Shape shape{static_cast<int64_t>(values.size()), 1};
  Tensor narrow = Tensor::from(values, shape), wide = narrow.to(DType::kFloat64);
  for (Tensor* x : {&narrow, &wide}) {
    x->set_requires_grad(true);
    const Tensor y = batch_norm(*x, Tensor::full({1}, 1.0, x->dtype()), Tensor::zeros({1}, x->dtype()),
                                Tensor(), Tensor(), {.training = true});
    Tensor dy = Tensor::zeros(shape, x->dtype());
    dy.copy_from(Tensor::from({1.0, -2.0, 0.5, 1.5}, shape).to(x->dtype()));
    backward(y, dy);
  }
  double error = 0.0, size = 0.0;
  for (int64_t i = 0; i < wide.numel(); ++i) {
    error = std::max(error, std::abs(narrow.grad().at(i) - wide.grad().at(i)));
    size = std::max(size, std::abs(wide.grad().at(i)));
  }
  return error / size;
}

TEST_CASE("a normalisation's gradient keeps its digits for huge values and for a mean far over the spread") {
  CHECK(batch_norm_gradient_error({1.0, -0.5, 2.0, 0.25}) < 1e-6);
  CHECK(batch_norm_gradient_error({1e30, -5e29, 2e30, 2.5e29}) < 1e-6);
  CHECK(batch_norm_gradient_error({10000.3, 10001.1, 9999.0, 9999.6}) < 1e-6);
}

TEST_CASE("huge values under a small weight are normalised") {
  const Tensor x = Tensor::from({1e30, -1e30}, {2, 1});
  const Tensor y = batch_norm(x, Tensor::full({1}, 1e-30), Tensor::zeros({1}), Tensor(), Tensor(), {});
  CHECK(y.at(0) == Approx(1e-30).epsilon(1e-5));
  CHECK(y.at(1) == Approx(-1e-30).epsilon(1e-5));
}

TEST_CASE("with constant statistics a batch_norm's gradient does not depend on its input") {
  const Tensor x = leaf({1.0, std::nan("")}, {2, 1});
  const Tensor y = batch_norm(x, Tensor::full({1}, 2.0), Tensor::zeros({1}), Tensor::zeros({1}),
                              Tensor::full({1}, 1.0), {.training = false});
  backward(y, Tensor::full({2, 1}, 1.0));
  CHECK(std::isnan(y.at(1)));
  CHECK(x.grad().at(0) == Approx(2.0).epsilon(1e-4));
  CHECK(x.grad().at(1) == x.grad().at(0));
}

}  // namespace
}  // namespace opaline
