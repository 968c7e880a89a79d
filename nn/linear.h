// Fully connected layers over the last dimension.
#pragma once

#include <functional>
#include <vector>

#include "core/ops/linear.h"
#include "nn/conv.h"
#include "nn/module.h"

namespace opaline {

struct LinearConfig {
  int64_t in = 0;
  int64_t out = 0;
  bool bias = true;
  DType dtype = DType::kFloat32;
};

/// y = x weight^T + bias. weight: out x in; bias: out.
class Linear : public Module {
 public:
  explicit Linear(const LinearConfig& config) : config_(config) {}
  Tensor forward(const Tensor& x) const { return linear(x, weight_, bias_); }

 private:
  LinearConfig config_;
  Tensor weight_ = add_parameter("weight", {config_.out, config_.in}, config_.dtype, kWeightInit);
  Tensor bias_ = config_.bias ? add_parameter("bias", {config_.out}, config_.dtype, {}) : Tensor();
};

struct FcStackConfig {
  std::vector<int64_t> widths;  ///< of the input, the hidden layers and the output: at least two
  std::function<Tensor(const Tensor&)> activation;  ///< after every layer but the last
  DType dtype = DType::kFloat32;
};

/// Linear layers `fc1`, `fc2`, .. with an activation between them.
class FcStack : public Module {
 public:
  explicit FcStack(const FcStackConfig& config);
  Tensor forward(const Tensor& x) const;

 private:
  std::function<Tensor(const Tensor&)> activation_;
  std::vector<Linear*> layers_;  // children, owned by Module
};

}  // namespace opaline
