// What each operation's errors are measured by. Internal to core/check.
#pragma once

#include <span>
#include <string>

#include "core/check/op_case.h"

namespace opaline::check {

/// The case on its inputs' magnitudes: of an operation that sums products, the results are the sums of its
/// terms' magnitudes.
OpCase on_magnitudes(OpCase op_case);

/// Whether what is computed on the way fits float32, as the scores of an attention may not.
bool computable(const OpCase& op_case, std::span<const Array> inputs);

/// The scale (stress.h) of the result called `name`, whose value and whose value on magnitudes are given;
/// `cotangent` is the largest. Throws Error where nothing says how to measure the operation.
Array error_scale(const OpCase& op_case, const std::string& name, const Array& value, const Array& terms,
                  std::span<const Array> inputs, double cotangent);

}  // namespace opaline::check
