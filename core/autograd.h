// Reverse-mode differentiation. Each operation that sees an input with requires_grad() records one Node on
// its result: the inputs and a function from the result's gradient to theirs. backward() walks the nodes from
// the loss, each once, in an order that depends on the graph alone; a node's saved tensors die as soon as it
// is done.
#pragma once

#include <functional>
#include <initializer_list>
#include <memory>
#include <span>
#include <string_view>
#include <vector>

#include "core/tensor.h"

namespace opaline {

/// From the gradient of the result to the gradients of the inputs, one each, in order. `needs[i]` says
/// whether input i wants one; an undefined Tensor stands for none. Keep inputs by saved() and read them by
/// restored(); keep results by detach(): a node that held its own result would never die.
using BackwardFunction = std::function<std::vector<Tensor>(const Tensor& grad, std::span<const char> needs)>;

struct Node {
  std::string_view operation;  ///< static string
  std::vector<Tensor> inputs;  ///< edges: without values
  BackwardFunction backward;
};

/// Whether operations record nodes on this thread.
bool grad_enabled();

/// While it lives, operations on this thread record nothing.
class NoGradGuard {
 public:
  NoGradGuard();
  ~NoGradGuard();
  NoGradGuard(const NoGradGuard&) = delete;
  NoGradGuard& operator=(const NoGradGuard&) = delete;

 private:
  bool before_;
};

/// Whether an operation on these inputs has to record: recording is on and one of them wants a gradient.
/// Undefined inputs (an absent bias) are skipped.
bool should_record(std::initializer_list<const Tensor*> inputs);
bool should_record(std::span<const Tensor> inputs);

/// Hangs a node on `result` and returns it. Call only where should_record() holds. Operations that cost as
/// little as reading memory say how to `recompute` their result, so that those which save it keep what it
/// came from instead.
Tensor record(std::string_view operation, Tensor result, const std::vector<Tensor>& inputs,
              BackwardFunction backward, Recompute recompute = nullptr);

/// `function` of the inputs without keeping what it computes on the way: backward() computes it once more
/// from the inputs (activation checkpointing, torch.utils.checkpoint). Results and gradients are those
/// without it to the last bit, so long as the function depends on its inputs and parameters alone.
/// `operation` (a static string) names the result's node.
using CheckpointFunction = std::function<Tensor(std::span<const Tensor> inputs)>;
Tensor checkpoint(std::string_view operation, CheckpointFunction function, const std::vector<Tensor>& inputs);

/// Whether checkpoint() computes its function again on this thread: running statistics have been updated
/// then.
bool recomputing();

/// Adds d(sum(root * seed))/d(leaf) to every leaf's grad(). An undefined seed means ones; root must then be a
/// scalar. The graph is consumed: saved tensors are freed on the way.
void backward(const Tensor& root, const Tensor& seed = {});

}  // namespace opaline
