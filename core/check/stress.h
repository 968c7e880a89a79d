// Numerical stress: every case of the registry on inputs that arithmetic in float32 finds hard, measured
// against float64. What the tests, `opaline bench stress` and scripts/parity/stress.py share.
#pragma once

#include <filesystem>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/check/op_case.h"
#include "core/check/run.h"
#include "core/numerics.h"

namespace opaline::check {

/// Inputs of one kind for any operation. Masks and running statistics stay those of the case.
struct Regime {
  std::string name;
  Fill first;                       ///< of the first input, and of a loss's target
  Fill others = fill::normal();     ///< of weights and second operands
  Fill cotangent = fill::normal();  ///< of what the result's gradient is multiplied by
};

/// Tiny, huge and mixed magnitudes, denormals, constants, signed zeros, one NaN or infinity, a variance far
/// below the square of the mean, saturation, and gradients of 1e-38 and 1e30.
const std::vector<Regime>& stress_regimes();

/// The case with the regime's inputs, as "operation/variant@regime".
OpCase stressed(const OpCase& op_case, const Regime& regime);

/// An error and its kind: `value` is infinite where a number came out of what is none, `lost` says that none
/// came out although one in float32's range was to.
struct StressError {
  double value = 0.0;
  bool lost = false;

  void include(const StressError& other);
};

/// What a tensor should hold, and what an error of each element is measured by: where sums cancel, the sum of
/// the terms' magnitudes rather than the result; one number for the whole tensor where its elements share a
/// sum.
struct Expected {
  Array value;
  Array scale;  ///< one number, or one an element

  /// Largest |actual - value| / scale. Scales are at least the smallest normal float32, so that a denormal
  /// result may have the error of its spacing, and no more. A result beyond float32's range need not be a
  /// number. `spreads`: where one value is none, others of the tensor need not be either.
  StressError error(const Array& actual, bool spreads = false) const;
};

struct StressErrors {
  StressError forward;   ///< of the result and the updated inputs
  StressError backward;  ///< of the gradients
};

/// One stressed case: its float64 results, computed once, and errors of float32 against them. Throws Error
/// where nothing says how to measure the operation (stress_scale.cpp).
class StressCase {
 public:
  StressCase(const OpCase& op_case, const Regime& regime);

  const OpCase& op_case() const { return case_; }
  /// "y", "updated.<input>", "grad.<input>": the names of scripts/golden/ops.py.
  const std::map<std::string, Expected>& expected() const { return expected_; }
  StressErrors run(Numerics numerics) const;

 private:
  OpCase case_;
  std::map<std::string, Expected> expected_;
  bool in_range_ = true;    ///< all inputs, results and gradients are in float32's range
  bool computable_ = true;  ///< so is what is computed on the way; else any result will do
};

/// An operation's worst errors, and the cases that have them.
struct StressSummary {
  std::string operation;
  StressErrors worst{};
  std::string forward_case = {}, backward_case = {};
  int64_t cases = 0;
  int64_t lost = 0;  ///< cases that lost a number
};

/// Every operation under every regime. `each` sees every case and its errors.
std::vector<StressSummary> run_stress(
    Numerics numerics, const std::function<void(const StressCase&, const StressErrors&)>& each = {});

/// Writes one file an operation: inputs, cotangents, float64 results and scales of every case, as
/// scripts/parity/stress.py reads them; metadata as write_case_inputs has it, with our errors. Returns what
/// run_stress does.
std::vector<StressSummary> export_stress(Numerics numerics, const std::filesystem::path& folder);

}  // namespace opaline::check
