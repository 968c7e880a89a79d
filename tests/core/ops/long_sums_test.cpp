// Every operation that sums, over a number of terms at which a running sum in float32 would stand still.
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <string>
#include <vector>

#include "core/check/op_case.h"
#include "core/check/run.h"
#include "core/memory.h"
#include "core/ops/activation.h"
#include "core/ops/arithmetic.h"
#include "core/ops/conv.h"
#include "core/ops/linear.h"
#include "core/ops/loss.h"
#include "core/ops/norm.h"
#include "core/ops/pool.h"
#include "core/ops/reduce.h"
#include "core/parallel.h"

namespace opaline::check {
namespace {

/// Between 0.1 and 1, spread evenly, no period and cheap. All positive: a sum grows until its spacing exceeds
/// the terms.
Fill spread() {
  return [](std::span<double> values, Random& random) {
    double at = random.uniform();
    for (double& v : values) {
      at += 0.6180339887498949;
      if (at >= 1.0) at -= 1.0;
      v = 0.1 + 0.9 * at;
    }
  };
}

OpCase sum_case(const std::string& name, const std::vector<Shape>& shapes,
                std::function<Tensor(std::span<const Tensor>)> forward, size_t differentiable = 3) {
  OpCase result{.name = "long_sum/" + name, .inputs = {}, .forward = std::move(forward), .reference = {}};
  for (size_t i = 0; i < shapes.size(); ++i) {
    result.inputs.push_back({.name = std::to_string(i),
                             .shape = shapes[i],
                             .fill = spread(),
                             .differentiable = i < differentiable});
  }
  result.cotangent = spread();
  return result;
}

/// Each has a sum of rows * columns terms in its result or in a gradient.
std::vector<OpCase> sum_cases(int64_t rows, int64_t columns) {
  const int64_t n = rows * columns;
  const Shape image{1, rows, columns, 1};
  const auto masked = [&](const std::string& name,
                          Tensor (*loss)(const Tensor&, const Tensor&, const Tensor&)) {
    return sum_case(
        name, {image, image, image}, [loss](auto in) { return loss(in[0], in[1], in[2]); }, 1);
  };
  return {
      sum_case("sum", {{n}}, [](auto in) { return sum(in[0]); }),
      sum_case("mean", {{n}}, [](auto in) { return mean(in[0]); }),
      sum_case("sum_axis", {{n, 1}}, [](auto in) { return sum(in[0], 0); }),
      sum_case("mean_axis", {{1, n}}, [](auto in) { return mean(in[0], 1); }),
      sum_case("add_scalar", {{n}, {}}, [](auto in) { return add(in[0], in[1]); }),
      sum_case("linear", {{1, n}, {1, n}}, [](auto in) { return linear(in[0], in[1], {}); }),
      sum_case("linear_gradients", {{n, 1}, {1, 1}, {1}},
               [](auto in) { return linear(in[0], in[1], in[2]); }),
      sum_case("matmul", {{1, n}, {n, 1}}, [](auto in) { return matmul(in[0], in[1], {}); }),
      sum_case("conv2d_gradients", {image, {1, 1, 1, 1}, {1}},
               [](auto in) { return conv2d(in[0], in[1], in[2], {}); }),
      sum_case("conv2d_3_gradients", {image, {1, 1, 3, 3}, {1}},
               [](auto in) { return conv2d(in[0], in[1], in[2], {.padding = 1}); }),
      sum_case("layer_norm", {{1, n}, {n}, {n}}, [](auto in) { return layer_norm(in[0], in[1], in[2]); }),
      sum_case("batch_norm", {{n, 1}, {1}, {1}},
               [](auto in) { return batch_norm(in[0], in[1], in[2], {}, {}, {}); }),
      sum_case("instance_norm", {image, {1}, {1}},
               [](auto in) { return instance_norm(in[0], in[1], in[2]); }),
      sum_case("softmax", {{n}}, [](auto in) { return softmax(in[0]); }),
      sum_case("adaptive_avg_pool2d", {image}, [](auto in) { return adaptive_avg_pool2d(in[0], 1, 1); }),
      masked("masked_l1_loss", masked_l1_loss),
      masked("masked_mse_loss", masked_mse_loss),
      masked("cosine_loss", cosine_loss),
      sum_case(
          "mse_loss", {{n}, {n}}, [](auto in) { return mse_loss(in[0], in[1]); }, 1),
  };
}

/// Largest |narrow - wide| over the largest |wide|, without copies: these tensors are large.
double tensor_error(const Tensor& narrow, const Tensor& wide) {
  const float* const a = narrow.data<float>();
  const double* const b = wide.data<double>();
  double error = 0.0, size = 0.0;
  for (int64_t i = 0; i < wide.numel(); ++i) {
    include_error(error, std::abs(static_cast<double>(a[i]) - b[i]));
    size = std::max(size, std::abs(b[i]));
  }
  return size > 0.0 ? error / size : error;
}

void check_sums(int64_t rows, int64_t columns) {
  for (const OpCase& op_case : sum_cases(rows, columns)) {
    tensor_pool().release_cached();  // no block is of use to the other type
    const CaseRun narrow = run_case(op_case, DType::kFloat32), wide = run_case(op_case, DType::kFloat64);
    INFO(op_case.name);
    CHECK(tensor_error(narrow.y, wide.y) < 1e-6);
    for (size_t i = 0; i < wide.gradients.size(); ++i) {
      if (!wide.gradients[i].defined()) continue;
      INFO("gradient " << i);
      CHECK(tensor_error(narrow.gradients[i], wide.gradients[i]) < 2e-6);
    }
  }
}

TEST_CASE("sums of a million terms keep their digits") {
  const ThreadsGuard one_thread(1);
  check_sums(1000, 1000);
}

TEST_CASE("sums of 1e8 terms keep their digits", "[.long]") {
  check_sums(10000, 10000);
}

TEST_CASE("a sum of 1e8 terms is exact where its terms are whole", "[.long]") {
  // 1, 2, .. 7, 1, 2, ..: the total is an integer that float64 holds.
  const int64_t n = 100'000'000;
  Tensor x({n});
  double expected = 0.0;
  for (int64_t i = 0; i < n; ++i) {
    x.data<float>()[i] = static_cast<float>(i % 7 + 1);
    expected += static_cast<double>(i % 7 + 1);
  }
  CHECK(sum(x).item() == static_cast<double>(static_cast<float>(expected)));
  CHECK(mean(x).item() == Approx(expected / static_cast<double>(n)).epsilon(1e-7));
}

}  // namespace
}  // namespace opaline::check
