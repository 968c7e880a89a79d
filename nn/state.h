// Named state in and out of maps: what modules and optimisers share.
#pragma once

#include <vector>

#include "core/safetensors.h"
#include "nn/module.h"

namespace opaline {

TensorMap to_map(const std::vector<NamedTensor>& entries);

/// Whether all elements are finite; integers always are.
bool all_finite(const Tensor& tensor);

/// Overwrites the tensors of `entries` by those of `state`, converting between float32 and float64. All
/// names, shapes, types and values are checked first: Error lists the full difference, and nothing has been
/// changed.
void load_state(const std::vector<NamedTensor>& entries, const TensorMap& state,
                const LoadStateOptions& options);

}  // namespace opaline
