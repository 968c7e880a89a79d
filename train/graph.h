// Walks over a recorded graph: for diagnoses and for counting work.
#pragma once

#include <cstdint>
#include <vector>

#include "core/tensor.h"

namespace opaline {

/// All tensors that `root` was computed from, root included, each after its own inputs. Call it before
/// backward(), which consumes the graph.
std::vector<Tensor> computation_order(const Tensor& root);

/// What a graph takes at least, whatever algorithms run. Multiply-accumulates are those of convolutions and
/// matrix products, by the direct count (what the formula says).
///
/// Bytes are those that operations move when each stands alone and the caches hold what it touches: a forward
/// pass reads its inputs, weights among them, and writes its result; a backward pass reads the gradient of
/// the result and those inputs that the wanted gradients are functions of, and writes these gradients; all of
/// it once. Sums, copies and averages have gradients that read no input, a factor of a product is read for
/// the gradient of the other, all other operations read all inputs. A reshape moves nothing. Adding up the
/// gradients of a tensor that is used several times is not counted, nor making results again, nor what no
/// node has as an input: targets and masks of losses.
struct WorkCount {
  int64_t forward = 0;   ///< multiply-accumulates
  int64_t backward = 0;  ///< multiply-accumulates for the gradients that are wanted: of inputs and of weights
  int64_t forward_bytes = 0;
  int64_t backward_bytes = 0;
};
/// Call it before backward(), which consumes the graph.
WorkCount count_work(const Tensor& root);

}  // namespace opaline
