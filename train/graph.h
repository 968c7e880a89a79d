// Walks over a recorded graph: for diagnoses and for counting work.
#pragma once

#include <cstdint>
#include <vector>

#include "core/tensor.h"

namespace opaline {

/// All tensors that `root` was computed from, root included, each after its own inputs. Call it before
/// backward(), which consumes the graph.
std::vector<Tensor> computation_order(const Tensor& root);

/// Multiply-accumulates of the convolutions and matrix products in a graph, by the direct count (what the
/// formula says, whatever algorithm ran).
struct WorkCount {
  int64_t forward = 0;
  int64_t backward = 0;  ///< for the gradients that are wanted: of inputs and of weights
};
WorkCount count_work(const Tensor& root);

}  // namespace opaline
