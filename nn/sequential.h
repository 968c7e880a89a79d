// Sequential: steps one after another, numbered as PyTorch numbers them.
#pragma once

#include <functional>
#include <string>
#include <utility>
#include <vector>

#include "nn/module.h"

namespace opaline {

/// Every step takes an index: a module's becomes its name, so "model.1.weight" is the weight of step 1 of the
/// sequence "model".
class Sequential : public Module {
 public:
  /// Appends a module that has Tensor forward(const Tensor&).
  template <class M, class... Args>
  M& add(Args&&... args) {
    M& module = add_child<M>(std::to_string(steps_.size()), std::forward<Args>(args)...);
    steps_.emplace_back([&module](const Tensor& x) { return module.forward(x); });
    return module;
  }

  /// Appends a function without parameters, such as an activation.
  void add_function(std::function<Tensor(const Tensor&)> function) { steps_.push_back(std::move(function)); }

  /// Takes an index and does nothing: for a step that PyTorch counts and ours does elsewhere (a reflection
  /// padding is part of our convolution, a rectifier of the normalisation before it).
  void skip() {
    add_function([](const Tensor& x) { return x; });
  }

  /// The steps from index `first` on.
  Tensor forward(const Tensor& x, size_t first = 0) const {
    Tensor y = x;
    for (size_t i = first; i < steps_.size(); ++i) y = steps_[i](y);
    return y;
  }

 private:
  std::vector<std::function<Tensor(const Tensor&)>> steps_;
};

}  // namespace opaline
