// Every case of the registry: against its reference, difference quotients, PyTorch's golden values, and
// itself on another number of threads.
#include <algorithm>
#include <catch2/catch.hpp>
#include <cstring>
#include <memory>
#include <regex>
#include <string>

#include "core/check/op_case.h"
#include "core/check/run.h"
#include "core/kernels/conv_plan.h"
#include "core/parallel.h"
#include "core/safetensors.h"

namespace opaline::check {
namespace {

bool same_bits(const Tensor& a, const Tensor& b) {
  if (a.defined() != b.defined()) return false;
  if (!a.defined()) return true;
  return a.shape() == b.shape() && a.dtype() == b.dtype() &&
         std::memcmp(a.bytes(), b.bytes(), static_cast<size_t>(a.byte_size())) == 0;
}

bool same_bits(const std::vector<Tensor>& a, const std::vector<Tensor>& b) {
  return std::equal(a.begin(), a.end(), b.begin(), b.end(),
                    [](const Tensor& p, const Tensor& q) { return same_bits(p, q); });
}

void check_same_bits(const OpCase& op_case, DType dtype) {
  const auto run_on = [&](int threads) {
    const ThreadsGuard guard(threads);
    return run_case(op_case, dtype, 1.0 / 3.0);
  };
  const CaseRun one = run_on(1), three = run_on(3);
  INFO(op_case.name << " " << to_string(dtype));
  CHECK(same_bits(one.y, three.y));
  CHECK(same_bits(one.gradients, three.gradients));
  CHECK(same_bits(one.updated, three.updated));
}

TEST_CASE("operations agree with their references") {
  const ThreadsGuard one_thread(1);
  for (const OpCase& op_case : op_cases()) {
    INFO(op_case.name);
    const CaseRun wide = run_case(op_case, DType::kFloat64);
    CHECK(reference_error(op_case, wide) <= op_case.tolerances.float64);
    const CaseRun narrow = run_case(op_case, DType::kFloat32);
    CHECK(reference_error(op_case, narrow) <= op_case.tolerances.float32);
    CHECK(gradient_difference(narrow, wide) <= op_case.tolerances.float32_gradient);
  }
}

TEST_CASE("gradients of operations are those of difference quotients") {
  const ThreadsGuard one_thread(1);
  for (const OpCase& op_case : op_cases()) {
    for (const GradientError& result : gradient_errors(op_case)) {
      INFO(op_case.name << " by " << result.name << ": relative error " << result.error);
      CHECK(result.error <= op_case.tolerances.gradient);
    }
  }
}

/// A plan that takes tiles of `outputs` for whatever convolution of this case can be done so; null where none
/// can.
std::shared_ptr<kernels::ConvPlan> forced_plan(const OpCase& op_case, int outputs) {
  const auto plan = std::make_shared<kernels::ConvPlan>(Numerics::kFast);
  {
    const NumericsGuard guard(plan);
    run_case(op_case, DType::kFloat64);
  }
  std::string json = plan->to_json();
  const bool small = json.find("kernel 3x3, stride 1") != std::string::npos;
  const bool large = json.find("kernel 7x7, stride 1") != std::string::npos;
  if (!(outputs == 3 ? large : small || (large && outputs == 0))) return nullptr;
  static const std::regex choice("(forward|input gradient|weight gradient)\": \\d");
  plan->load(std::regex_replace(json, choice, "$1\": " + std::to_string(outputs)), op_case.name);
  return plan;
}

TEST_CASE("convolutions agree with reference, quotients and PyTorch by every algorithm") {
  const ThreadsGuard one_thread(1);
  const TensorMap golden = load_safetensors(std::string(OPALINE_TEST_DATA) + "/conv2d.safetensors").tensors;
  int runs = 0;
  for (const OpCase& op_case : op_cases()) {
    if (op_case.operation() != "conv2d" || op_case.variant() == "nan") continue;  // NaN fills whole tiles
    for (const int outputs : {0, 2, 3, 4, 6}) {
      const auto plan = forced_plan(op_case, outputs);
      if (!plan) continue;
      ++runs;
      const NumericsGuard guard(plan);
      INFO(op_case.name << ", tiles of " << outputs);
      const CaseRun wide = run_case(op_case, DType::kFloat64), narrow = run_case(op_case, DType::kFloat32);
      CHECK(reference_error(op_case, wide) <= op_case.tolerances.float64);
      if (op_case.in_pytorch) {
        CHECK(golden_error(op_case, wide, golden) <= op_case.tolerances.golden);
      }
      CHECK(reference_error(op_case, narrow) <= 2.0 * op_case.tolerances.float32);
      CHECK(gradient_difference(narrow, wide) <= op_case.tolerances.float32_gradient);
      // A convolution is linear in each input, so that large steps lose nothing but the rounding of the
      // larger tiles.
      for (const GradientError& result :
           gradient_errors(op_case, {.directions = 3, .elements = 12, .step = 1000.0})) {
        INFO("by " << result.name << ": relative error " << result.error);
        CHECK(result.error <= op_case.tolerances.gradient);
      }
    }
  }
  CHECK(runs > 40);
}

TEST_CASE("operations agree with PyTorch") {
  const ThreadsGuard one_thread(1);
  TensorMap golden;
  std::string loaded;
  for (const OpCase& op_case : op_cases()) {
    if (!op_case.in_pytorch) continue;
    if (loaded != op_case.operation()) {
      loaded = op_case.operation();
      golden = load_safetensors(std::string(OPALINE_TEST_DATA) + "/" + loaded + ".safetensors").tensors;
    }
    INFO(op_case.name);
    CHECK(golden_error(op_case, run_case(op_case, DType::kFloat64), golden) <= op_case.tolerances.golden);
  }
}

TEST_CASE("operations give the same bits for any number of threads") {
  for (const OpCase& op_case : op_cases()) {
    for (const DType dtype : {DType::kFloat32, DType::kFloat64}) check_same_bits(op_case, dtype);
  }
}

// Small cases are one unit of work; these are cut into several.
TEST_CASE("large operations give the same bits for any number of threads") {
  for (const OpCase& op_case : large_op_cases(40)) {
    for (const DType dtype : {DType::kFloat32, DType::kFloat64}) check_same_bits(op_case, dtype);
  }
}

TEST_CASE("large operations agree with their references") {
  for (const OpCase& op_case : large_op_cases(24)) {
    INFO(op_case.name);
    CHECK(reference_error(op_case, run_case(op_case, DType::kFloat32)) <= op_case.tolerances.float32);
  }
}

}  // namespace
}  // namespace opaline::check
