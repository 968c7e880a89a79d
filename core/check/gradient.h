// Gradients against difference quotients: what the checks of single operations, of whole networks and of a
// training loss share.
#pragma once

#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <vector>

#include "core/tensor.h"

namespace opaline::check {

/// A float64 tensor whose grad() is to be checked.
struct Leaf {
  std::string name;
  Tensor tensor;
};

struct GradientOptions {
  int64_t directions = 1;  ///< dense directions a leaf: each moves every element
  int64_t elements = 0;    ///< single elements a leaf
  int max_draws = 20;      ///< of a probe, before it counts as failed
  /// Steps as a multiple of the usual ones: more suits a function that is linear in each leaf, whose
  /// quotients are exact at any step and lose fewer digits at a large one.
  double step = 1.0;
  uint64_t seed = 1;
};

struct GradientError {
  std::string name;
  /// Largest |quotient - gradient| of a probe over the scale of what it measures: the gradient's norm for a
  /// direction, the element for an element; not less than a hundredth of what is typical among the leaves, so
  /// that gradients that are zero in exact arithmetic (a bias before a norm) have a scale too. NaN where a
  /// probe found no smooth place.
  double error = 0.0;
  double norm = 0.0;  ///< of the gradient
  int64_t redrawn = 0;
};

/// Checks the gradients of `loss`, which the leaves hold already. `loss` is called with leaves moved in place
/// by small steps, and has to give the change against the unmoved ones, so that no digits are lost.
///
/// A probe is a central difference with one Richardson step. Where a ReLU or a maximum changes its choice
/// between the points, quotients of different steps disagree by far more than a smooth function's; the probe
/// is then drawn again, with a smaller step. The gradient has no part in that decision.
std::vector<GradientError> check_gradients(const std::function<double()>& loss, std::span<const Leaf> leaves,
                                           const GradientOptions& options = {});

}  // namespace opaline::check
