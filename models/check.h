// Gradient checks of whole networks in float64: what the tests and `opaline gradcheck` share.
#pragma once

#include <string_view>
#include <vector>

#include "core/check/gradient.h"
#include "models/network.h"

namespace opaline {

/// Sizes at which a check of a network takes seconds. At width 4 the decoder's last hidden layer has one
/// channel, whose ReLU may die; it gets more.
NetworkOptions small_network_options(std::string_view name);

/// Shape of a network's input (channels last) for a batch of images at the build size.
Shape network_input_shape(std::string_view name, int64_t batch, const NetworkOptions& options);

/// Gradients of sum(y * cotangent) by every parameter and the input "x", for weights, statistics, input and
/// cotangent that are nowhere trivial; with `sites`, of a batch of the build size, on these alone. Throws
/// UsageError on an unknown name.
std::vector<check::GradientError> network_gradient_errors(
    std::string_view name, bool training, const check::GradientOptions& options = {},
    const std::shared_ptr<const ActiveSites>& sites = nullptr);

}  // namespace opaline
