// The gradient check of a config: its cascade with its losses, at a small size.
#pragma once

#include <vector>

#include "core/check/gradient.h"
#include "train/config.h"

namespace opaline {

/// Gradients of the stage's weighted loss by every parameter that its losses reach and that is not frozen:
/// the config's variant, inputs, reconstruction, loss kinds and weights, but 32 x 32 images, width 4 and
/// float64, on made-up images and targets. In training mode, as training runs it.
std::vector<check::GradientError> config_gradient_errors(const RunConfig& config, int stage,
                                                         const check::GradientOptions& options = {});

}  // namespace opaline
