#include "core/autograd.h"

#include <unordered_map>
#include <unordered_set>

#include "core/numerics.h"
#include "core/parallel.h"

namespace opaline {
namespace {

bool& grad_mode() {
  thread_local bool enabled = true;
  return enabled;
}

bool& recompute_mode() {
  thread_local bool on = false;
  return on;
}

/// Sets a flag for as long as it lives.
class FlagGuard {
 public:
  FlagGuard(bool& flag, bool value) : flag_(flag), before_(flag) { flag_ = value; }
  ~FlagGuard() { flag_ = before_; }
  FlagGuard(const FlagGuard&) = delete;
  FlagGuard& operator=(const FlagGuard&) = delete;

 private:
  bool& flag_;
  bool before_;
};

/// a += b, in place: `a` is a gradient buffer that backward() owns.
void accumulate(Tensor& a, const Tensor& b) {
  dispatch_floating("backward", a.dtype(), [&]<class T>() {
    T* const to = a.data<T>();
    const T* const from = b.data<T>();
    parallel_blocks(a.numel(), 1 << 16, [&](int64_t begin, int64_t end) {
      for (int64_t i = begin; i < end; ++i) to[i] += from[i];
    });
  });
}

/// The nodes' results from the root down to the leaves, each after everything that uses it.
std::vector<Tensor> reverse_topological_order(const Tensor& root) {
  std::vector<Tensor> post_order;
  std::unordered_set<const void*> seen{root.id()};
  struct Frame {
    Tensor tensor;
    size_t next_input;
  };
  std::vector<Frame> stack{{root, 0}};
  while (!stack.empty()) {
    Frame& top = stack.back();
    const auto& inputs = top.tensor.node()->inputs;
    if (top.next_input == inputs.size()) {
      post_order.push_back(std::move(top.tensor));
      stack.pop_back();
      continue;
    }
    const Tensor input = inputs[top.next_input++];
    if (input.defined() && input.node() && seen.insert(input.id()).second) stack.push_back({input, 0});
  }
  return {post_order.rbegin(), post_order.rend()};
}

}  // namespace

bool grad_enabled() {
  return grad_mode();
}

NoGradGuard::NoGradGuard() : before_(grad_mode()) {
  grad_mode() = false;
}

NoGradGuard::~NoGradGuard() {
  grad_mode() = before_;
}

bool should_record(std::initializer_list<const Tensor*> inputs) {
  if (!grad_enabled()) return false;
  for (const Tensor* input : inputs) {
    if (input->defined() && input->requires_grad()) return true;
  }
  return false;
}

bool should_record(std::span<const Tensor> inputs) {
  if (!grad_enabled()) return false;
  for (const Tensor& input : inputs) {
    if (input.defined() && input.requires_grad()) return true;
  }
  return false;
}

Tensor record(std::string_view operation, Tensor result, const std::vector<Tensor>& inputs,
              BackwardFunction backward, Recompute recompute) {
  std::vector<Tensor> edges;
  edges.reserve(inputs.size());
  for (const Tensor& input : inputs) edges.push_back(input.defined() ? input.edge() : Tensor());
  result.set_node(std::make_shared<Node>(Node{operation, std::move(edges), std::move(backward)}));
  if (recompute) result.set_recompute(std::move(recompute), inputs);
  return result;
}

bool recomputing() {
  return recompute_mode();
}

Tensor checkpoint(std::string_view operation, CheckpointFunction function,
                  const std::vector<Tensor>& inputs) {
  Tensor result = function(inputs);
  if (!result.requires_grad()) return result;
  // The graph that the function recorded told whether a gradient is wanted, and goes.
  result = result.detach();
  std::vector<Tensor> kept;
  for (const Tensor& input : inputs) kept.push_back(input.defined() ? input.saved() : Tensor());
  return record(operation, result, inputs,
                [function = std::move(function), kept = std::move(kept), plan = current_conv_plan()](
                    const Tensor& grad, std::span<const char> needs) {
                  std::vector<Tensor> leaves;
                  for (size_t i = 0; i < kept.size(); ++i) {
                    leaves.push_back(kept[i].defined() ? kept[i].restored().detach() : Tensor());
                    if (needs[i]) leaves[i].set_requires_grad(true);
                  }
                  const NumericsGuard numerics(plan);
                  Tensor again;
                  {
                    const FlagGuard recording(grad_mode(), true), recompute(recompute_mode(), true);
                    again = function(leaves);
                  }
                  backward(again, grad);
                  std::vector<Tensor> grads;
                  for (const Tensor& leaf : leaves) grads.push_back(leaf.defined() ? leaf.grad() : Tensor());
                  return grads;
                });
}

void backward(const Tensor& root, const Tensor& seed) {
  if (!root.requires_grad()) fail("backward", "the root has no history: no input required a gradient");
  Tensor initial = seed.defined() ? seed.clone() : Tensor::full(root.shape(), 1.0, root.dtype());
  if (!seed.defined() && root.numel() != 1) {
    fail("backward", "a root of shape {} needs a seed", to_string(root.shape()));
  }
  if (initial.shape() != root.shape() || initial.dtype() != root.dtype()) {
    fail("backward", "seed {} {} for a root {} {}", to_string(initial.dtype()), to_string(initial.shape()),
         to_string(root.dtype()), to_string(root.shape()));
  }
  const NoGradGuard no_grad;

  // A gradient that an operation returned may share storage with another one (reshape, add); it is copied
  // before anything is added to it.
  struct Gradient {
    Tensor value;
    bool owned = false;
  };
  std::unordered_map<const void*, Gradient> gradients;
  const auto deliver = [&](Tensor target, const Tensor& value) {
    if (value.shape() != target.shape() || value.dtype() != target.dtype()) {
      fail("backward", "gradient {} {} for a tensor {} {}", to_string(value.dtype()),
           to_string(value.shape()), to_string(target.dtype()), to_string(target.shape()));
    }
    if (target.node()) {
      auto [entry, fresh] = gradients.try_emplace(target.id(), Gradient{value, false});
      if (fresh) return;
      if (!entry->second.owned) entry->second = {entry->second.value.clone(), true};
      accumulate(entry->second.value, value);
    } else if (target.grad().defined()) {
      Tensor grad = target.grad();
      accumulate(grad, value);
    } else {
      target.set_grad(value.shared() ? value.clone() : value);
    }
  };

  if (!root.node()) {
    deliver(root, initial);
    return;
  }
  std::vector<Tensor> order = reverse_topological_order(root);
  gradients.emplace(root.id(), Gradient{initial, true});
  for (Tensor& tensor : order) {
    const std::shared_ptr<Node> node = tensor.node();
    if (!node->backward) {
      fail(node->operation, "its saved tensors are gone: backward ran through this graph before");
    }
    const auto found = gradients.find(tensor.id());
    if (found != gradients.end()) {
      const Tensor grad = std::move(found->second.value);
      gradients.erase(found);
      std::vector<char> needs(node->inputs.size());
      for (size_t i = 0; i < needs.size(); ++i) {
        needs[i] = node->inputs[i].defined() && node->inputs[i].requires_grad();
      }
      const std::vector<Tensor> input_grads = node->backward(grad, needs);
      for (size_t i = 0; i < needs.size(); ++i) {
        if (needs[i] && i < input_grads.size() && input_grads[i].defined()) {
          deliver(node->inputs[i], input_grads[i]);
        }
      }
    }
    // Frees what the node saved; the tensor itself keeps its (spent) node so that it still knows its history.
    node->backward = nullptr;
    node->inputs.clear();
    tensor = {};
  }
}

}  // namespace opaline
