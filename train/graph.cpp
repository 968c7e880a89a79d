#include "train/graph.h"

#include <algorithm>
#include <set>
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
    // Two products of all queries with all keys of their image.
    if (const auto& sites = result.sites()) {
      int64_t pairs = 0;
      for (int64_t image = 0; image < sites->n(); ++image) {
        const int64_t count = sites->first(image + 1) - sites->first(image);
        pairs += count * count;
      }
      return 2 * pairs * result.size(1);
    }
    return 2 * result.numel() * inputs[1].size(1);
  }
  return 0;
}

bool wants_gradient(const Tensor& input) {
  return input.defined() && input.requires_grad();
}

/// Inputs that make up the first factor of a product: the parts of a convolution's image, or one. The second
/// factor is the input after them.
size_t first_factor(const Node& node) {
  return node.operation == "conv2d" ? node.inputs.size() - 2 : 1;
}
/// Channels of the first factor, or of those of its parts whose gradient is wanted.
int64_t wanted_channels(const Node& node, bool wanted_alone) {
  int64_t channels = 0;
  for (size_t i = 0; i < first_factor(node); ++i) {
    if (!wanted_alone || wants_gradient(node.inputs[i])) channels += node.inputs[i].size(-1);
  }
  return channels;
}
bool wants_first_factor(const Node& node) {
  const auto begin = node.inputs.begin();
  return std::any_of(begin, begin + static_cast<std::ptrdiff_t>(first_factor(node)), wants_gradient);
}

/// Whether the wanted gradients of an operation are functions of its input i.
bool backward_reads(const Node& node, size_t i) {
  static const std::set<std::string_view> kProducts = {"conv2d", "conv_transpose2d", "linear", "matmul",
                                                       "mul"};
  static const std::set<std::string_view> kConstantDerivative = {"adaptive_avg_pool2d",
                                                                 "add",
                                                                 "affine",
                                                                 "concat",
                                                                 "expand",
                                                                 "expand_to_sites",
                                                                 "mean",
                                                                 "permute",
                                                                 "reflection_pad2d",
                                                                 "select_sites",
                                                                 "slice",
                                                                 "sub",
                                                                 "sum",
                                                                 "to_dense",
                                                                 "upsample_bilinear",
                                                                 "upsample_nearest"};
  if (kConstantDerivative.contains(node.operation)) return false;
  if (!kProducts.contains(node.operation)) return true;
  const size_t second = first_factor(node);
  if (i < second) return wants_gradient(node.inputs[second]);
  return i == second && wants_first_factor(node);
}

void count_bytes(const Node& node, const Tensor& result, WorkCount& count) {
  if (node.operation == "reshape") return;
  count.forward_bytes += result.byte_size();
  count.backward_bytes += result.byte_size();
  for (size_t i = 0; i < node.inputs.size(); ++i) {
    const Tensor& input = node.inputs[i];
    if (!input.defined()) continue;
    count.forward_bytes += input.byte_size();
    if (backward_reads(node, i)) count.backward_bytes += input.byte_size();
    if (wants_gradient(input)) count.backward_bytes += input.byte_size();
  }
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
    count_bytes(*node, tensor, count);
    const int64_t work = operation_work(*node, tensor);
    if (work == 0) continue;
    count.forward += work;
    // Each of the two factors costs as much again, so far as its gradient is wanted.
    count.backward += work * wanted_channels(*node, true) / wanted_channels(*node, false);
    if (wants_gradient(node->inputs[first_factor(*node)])) count.backward += work;
  }
  return count;
}

}  // namespace opaline
