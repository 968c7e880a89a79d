// Runs operation cases and measures their errors: what the tests, the benchmark and `opaline gradcheck`
// share.
#pragma once

#include <vector>

#include "core/check/gradient.h"
#include "core/check/op_case.h"
#include "core/safetensors.h"

namespace opaline::check {

/// A case's forward and backward pass.
struct CaseRun {
  Tensor y;
  std::vector<Tensor> gradients;  ///< one an input; undefined where it is not differentiable
  std::vector<Tensor> updated;    ///< the updated inputs, in order
};
/// Differentiable inputs are multiplied by `scale`: one that is no power of two leaves numbers whose float64
/// sums round, as those of float32 numbers seldom do.
CaseRun run_case(const OpCase& op_case, DType dtype, double scale = 1.0);

/// Error of the result and the updated inputs against the case's reference (relative_error).
double reference_error(const OpCase& op_case, const CaseRun& run);

/// Largest error of the gradients against those of another run of the case, in float64.
double gradient_difference(const CaseRun& run, const CaseRun& expected);

/// Float64 gradients against difference quotients: one result a differentiable input, none where the case is
/// not smooth.
std::vector<GradientError> gradient_errors(const OpCase& op_case, const GradientOptions& options = {
                                                                      .directions = 3, .elements = 12});

/// Largest error of result, gradients and updated inputs against golden values made by
/// scripts/golden/ops.py; `golden` is the file of the case's operation. A tensor of up to 256 values is there
/// as it is; of a larger one a sample and the norm. Throws Error where the case is not in the file.
double golden_error(const OpCase& op_case, const CaseRun& run, const TensorMap& golden);

}  // namespace opaline::check
