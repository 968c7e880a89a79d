#include "train/graph.h"

#include <algorithm>
#include <unordered_set>

#include "core/autograd.h"

namespace opaline {
namespace {

/// Multiply-accumulates of one operation; 0 for those that are not counted.
int64_t operation_work(const Node& node, const Tensor& result) {
  const std::vector<Tensor>& inputs = node.inputs;
  if (node.operation == "conv2d") {
    const Tensor& weight = inputs[inputs.size() - 2];
    return result.numel() * weight.size(1) * weight.size(2) * weight.size(3);
  }
  if (node.operation == "conv_transpose2d") {
    return inputs[0].numel() * inputs[1].size(1) * inputs[1].size(2) * inputs[1].size(3);
  }
  if (node.operation == "linear") return result.numel() * inputs[1].size(1);
  if (node.operation == "matmul") {
    // The inner dimension, wherever a transposition has put it: a has batch * M * K elements.
    const int64_t rows = result.numel() / result.size(-1);
    return result.numel() * (inputs[0].numel() / rows);
  }
  if (node.operation == "scaled_dot_product_attention") {
    // Two products of all queries with all keys.
    return 2 * result.numel() * inputs[1].size(1);
  }
  return 0;
}

}  // namespace

std::vector<Tensor> computation_order(const Tensor& root) {
  struct Frame {
    Tensor tensor;
    size_t next = 0;
  };
  std::vector<Tensor> order;
  std::unordered_set<const void*> seen{root.id()};
  std::vector<Frame> stack;
  stack.push_back({root});
  while (!stack.empty()) {
    Frame& top = stack.back();
    const Node* const node = top.tensor.node().get();
    if (node == nullptr || top.next == node->inputs.size()) {
      order.push_back(std::move(top.tensor));
      stack.pop_back();
      continue;
    }
    const Tensor input = node->inputs[top.next++];
    if (input.defined() && seen.insert(input.id()).second) stack.push_back({input});
  }
  return order;
}

WorkCount count_work(const Tensor& root) {
  WorkCount count;
  for (const Tensor& tensor : computation_order(root)) {
    const Node* const node = tensor.node().get();
    if (node == nullptr) continue;
    const int64_t work = operation_work(*node, tensor);
    if (work == 0) continue;
    count.forward += work;
    // Each of the two factors costs as much again, if its gradient is wanted. The first may come in parts.
    const size_t parts = node->operation == "conv2d" ? node->inputs.size() - 2 : 1;
    const auto wanted = [](const Tensor& input) { return input.requires_grad(); };
    if (std::any_of(node->inputs.begin(), node->inputs.begin() + static_cast<std::ptrdiff_t>(parts),
                    wanted)) {
      count.backward += work;
    }
    if (wanted(node->inputs[parts])) count.backward += work;
  }
  return count;
}

}  // namespace opaline
