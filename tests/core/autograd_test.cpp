#include "core/autograd.h"

#include <algorithm>
#include <catch2/catch.hpp>
#include <thread>

#include "core/memory.h"
#include "core/ops/activation.h"
#include "core/ops/arithmetic.h"
#include "core/ops/reduce.h"
#include "core/ops/shape.h"
#include "core/ops/unary.h"

namespace opaline {
namespace {

Tensor leaf(std::initializer_list<double> values) {
  Tensor x = Tensor::from(values, {static_cast<int64_t>(values.size())}, DType::kFloat64);
  x.set_requires_grad(true);
  return x;
}

TEST_CASE("backward reaches every leaf") {
  const Tensor a = leaf({1, 2}), b = leaf({3, 5});
  backward(sum(mul(a, b)));
  CHECK(a.grad().at(0) == 3.0);
  CHECK(a.grad().at(1) == 5.0);
  CHECK(b.grad().at(1) == 2.0);
  CHECK(!a.grad().requires_grad());
}

TEST_CASE("gradients add up over backward passes until they are cleared") {
  Tensor a = leaf({1, 2});
  backward(sum(square(a)));
  const Tensor first = a.grad();
  backward(sum(square(a)));
  CHECK(a.grad().at(1) == 8.0);
  CHECK(first.at(1) == 8.0);  // the same buffer, added to in place
  a.zero_grad();
  CHECK(!a.grad().defined());
  backward(sum(a));
  CHECK(a.grad().at(1) == 1.0);
}

TEST_CASE("a tensor used several times gets the sum") {
  const Tensor a = leaf({3});
  const Tensor b = square(a);        // 9
  const Tensor c = add(b, b);        // 2 a^2
  const Tensor d = mul(c, a);        // 2 a^3
  backward(sum(add(d, mul(b, b))));  // + a^4
  CHECK(a.grad().at(0) == Approx(6 * 9 + 4 * 27));
}

TEST_CASE("gradients that share storage are not added to in place") {
  // add hands the same gradient to both inputs, reshape a view of it.
  const Tensor a = leaf({1, 2}), b = leaf({1, 2});
  const Tensor x = reshape(affine(a, 1.0), {2}), y = affine(b, 1.0);
  const Tensor sum_of_both = add(x, y);
  backward(sum(add(add(sum_of_both, x), mul(y, y))));
  CHECK(a.grad().at(0) == 2.0);
  CHECK(b.grad().at(0) == 3.0);
  CHECK(b.grad().at(1) == 5.0);
}

TEST_CASE("a seed weights the elements of the root") {
  const Tensor a = leaf({1, 2, 3});
  const Tensor seed = Tensor::from({1, 0, -2}, {3}, DType::kFloat64);
  backward(square(a), seed);
  CHECK(a.grad().at(0) == 2.0);
  CHECK(a.grad().at(1) == 0.0);
  CHECK(a.grad().at(2) == -12.0);
  CHECK(seed.at(2) == -2.0);
}

TEST_CASE("roots and seeds that do not fit are refused") {
  const Tensor a = leaf({1, 2});
  CHECK_THROWS_WITH(backward(square(a)), Catch::Contains("2") && Catch::Contains("seed"));
  CHECK_THROWS_WITH(backward(square(a), Tensor::zeros({3}, DType::kFloat64)), Catch::Contains("3"));
  CHECK_THROWS_WITH(backward(square(a), Tensor::zeros({2})), Catch::Contains("float32"));
  CHECK_THROWS_WITH(backward(Tensor::scalar(1.0)), Catch::Contains("no history"));
  CHECK(!a.grad().defined());
}

TEST_CASE("a leaf may be the root") {
  Tensor a = Tensor::scalar(2.0, DType::kFloat64);
  a.set_requires_grad(true);
  backward(a);
  CHECK(a.grad().item() == 1.0);
}

TEST_CASE("without gradients nothing is recorded") {
  const Tensor a = leaf({1, 2});
  {
    const NoGradGuard outer;
    CHECK(!grad_enabled());
    { const NoGradGuard inner; }
    CHECK(!grad_enabled());
    CHECK(!square(a).requires_grad());
    bool other_thread = false;
    std::thread([&] { other_thread = grad_enabled(); }).join();
    CHECK(other_thread);
  }
  CHECK(grad_enabled());
  CHECK(square(a).requires_grad());
  // Nor where no input wants one.
  CHECK(!square(Tensor::zeros({2})).requires_grad());
  CHECK(!square(a.detach()).requires_grad());
}

TEST_CASE("inputs that want no gradient get none") {
  const Tensor a = leaf({1, 2}), constant = Tensor::from({4, 5}, {2}, DType::kFloat64);
  backward(sum(mul(a, constant)));
  CHECK(a.grad().at(1) == 5.0);
  CHECK(!constant.grad().defined());
}

TEST_CASE("a graph is consumed by its backward pass") {
  const Tensor a = leaf({1, 2});
  const Tensor loss = sum(square(a));
  backward(loss);
  CHECK_THROWS_WITH(backward(loss), Catch::Contains("backward ran through this graph before"));
  CHECK(a.grad().at(1) == 4.0);
}

TEST_CASE("two roots may share a part that only one of them walks") {
  const Tensor a = leaf({2});
  const Tensor shared = square(a);
  const Tensor first = sum(shared), second = sum(mul(shared, shared));
  backward(first);
  CHECK(a.grad().at(0) == 4.0);
  CHECK_THROWS_AS(backward(second), Error);
}

TEST_CASE("saved tensors are freed while backward runs") {
  constexpr int64_t kCount = 1 << 16, kBytes = kCount * 8;
  constexpr int kLinks = 16;
  Tensor x = Tensor::full({kCount}, 1.0, DType::kFloat64);
  x.set_requires_grad(true);
  Tensor y = x;
  for (int i = 0; i < kLinks; ++i) y = mul(y, y);
  Tensor loss = sum(y);
  y = {};
  const int64_t before = tensor_pool().bytes_in_use();
  CHECK(before >= kLinks * kBytes);
  tensor_pool().reset_peak();
  backward(loss);
  // The gradients in flight are few (one comes in, two products and their sum): what the walk has passed is
  // free.
  CHECK(tensor_pool().peak_bytes() - before < 5 * kBytes);
  // Only x, its gradient and the loss remain, although `loss` still stands.
  CHECK(tensor_pool().bytes_in_use() <= before - (kLinks - 2) * kBytes);
}

TEST_CASE("what is cheap to compute is not kept, but computed again") {
  constexpr int64_t kCount = 1 << 16, kBytes = kCount * 8;
  Tensor x = Tensor::full({kCount}, 3.0, DType::kFloat64);
  x.set_requires_grad(true);
  const Tensor kept = mul(x, x);
  const int64_t before = tensor_pool().bytes_in_use();
  Tensor y = relu(affine(kept, -1.0, 10.0));
  const Tensor loss = sum(square(y));
  const Tensor saved = y.saved();
  CHECK(saved.restored().at(0) == 1.0);  // found where it still is
  y = {};
  CHECK(tensor_pool().bytes_in_use() < before + kBytes);
  CHECK_THROWS_AS(saved.at(0), Error);
  CHECK(saved.restored().at(0) == 1.0);  // made again
  backward(loss);
  CHECK(x.grad().at(0) == 2.0 * 1.0 * -1.0 * 2.0 * 3.0);
}

TEST_CASE("long chains of cheap operations keep values on the way") {
  Tensor x = leaf({1});
  Tensor y = x;
  int kept = 0;
  for (int i = 0; i < 20; ++i) {
    y = affine(y, 1.0);
    if (!y.recomputes()) ++kept;
  }
  CHECK(kept == 4);
}

/// w * x * x * .., in links that each keep a tensor.
Tensor chain(const Tensor& x, const Tensor& w, int links) {
  Tensor y = mul(x, w);
  for (int i = 0; i < links; ++i) y = mul(y, x);
  return y;
}

TEST_CASE("a checkpoint keeps its inputs alone and gives the same gradients to the bit") {
  constexpr int64_t kCount = 1 << 16, kBytes = kCount * 8;
  constexpr int kLinks = 16;
  Tensor x = Tensor::full({kCount}, 1.1, DType::kFloat64), w = Tensor::full({kCount}, 0.7, DType::kFloat64);
  x.set_requires_grad(true);
  w.set_requires_grad(true);
  const Tensor squared = square(x);
  backward(sum(chain(squared, w, kLinks)));
  const Tensor dx = x.grad(), dw = w.grad();
  x.zero_grad();
  w.zero_grad();

  int calls = 0;
  const CheckpointFunction once = [&](std::span<const Tensor> in) {
    ++calls;
    CHECK(recomputing() == (calls > 1));
    return chain(in[0], w, kLinks);
  };
  const CheckpointFunction nested = [&](std::span<const Tensor> in) {
    return checkpoint("inner", once, {in[0]});
  };
  const bool inner = GENERATE(false, true);
  const int64_t before = tensor_pool().bytes_in_use();
  Tensor loss = sum(checkpoint("chain", inner ? nested : once, {square(x)}));
  CHECK(tensor_pool().bytes_in_use() - before < 3 * kBytes);
  CHECK(calls == 1);
  backward(loss);
  CHECK(calls == (inner ? 3 : 2));
  CHECK(!recomputing());
  CHECK(std::ranges::equal(x.grad().values<double>(), dx.values<double>()));
  CHECK(std::ranges::equal(w.grad().values<double>(), dw.values<double>()));
}

TEST_CASE("a checkpoint records nothing where no gradient is wanted") {
  const Tensor x = Tensor::full({2}, 3.0, DType::kFloat64), w = leaf({5, 7});
  int calls = 0;
  const auto product = [&](std::span<const Tensor> in) {
    ++calls;
    return in.size() == 2 ? mul(in[0], in[1]) : mul(in[0], w);
  };
  CHECK(!checkpoint("product", product, {x, x}).requires_grad());
  {
    const NoGradGuard no_grad;
    CHECK(!checkpoint("product", product, {x}).requires_grad());
  }
  calls = 0;
  backward(sum(checkpoint("product", product, {x})));  // for the parameter alone
  CHECK(calls == 2);
  CHECK(w.grad().at(0) == 3.0);
  CHECK(!x.grad().defined());
  backward(sum(checkpoint("product", product, {x, w})));  // for one of two inputs
  CHECK(w.grad().at(0) == 6.0);
}

TEST_CASE("a graph that is never walked dies with its root") {
  const int64_t before = tensor_pool().bytes_in_use();
  {
    Tensor x = Tensor::zeros({1024}, DType::kFloat64);
    x.set_requires_grad(true);
    Tensor y = x;
    for (int i = 0; i < 5; ++i) y = square(y);
  }
  CHECK(tensor_pool().bytes_in_use() == before);
}

TEST_CASE("a long graph neither dies nor walks by recursion") {
  Tensor x = leaf({1});
  Tensor y = x;
  for (int i = 0; i < 200'000; ++i) y = affine(y, 1.0);
  Tensor unused = y;
  for (int i = 0; i < 200'000; ++i) unused = affine(unused, 1.0);
  unused = {};
  backward(y);
  CHECK(x.grad().at(0) == 1.0);
}

}  // namespace
}  // namespace opaline
