// Optimisers.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/safetensors.h"
#include "nn/module.h"

namespace opaline {

struct AdamOptions {
  double learning_rate = 2e-4;
  double beta1 = 0.5;
  double beta2 = 0.999;
  double eps = 1e-8;
};

/// Adam (Kingma and Ba, ICLR 2015) as PyTorch computes it. For a parameter p with gradient g at its step t:
///   m = beta1 m + (1 - beta1) g,  v = beta2 v + (1 - beta2) g^2
///   p -= rate / (1 - beta1^t) * m / (sqrt(v) / sqrt(1 - beta2^t) + eps)
/// Moments have the parameter's type; the arithmetic is in that type, the coefficients in float64.
class Adam {
 public:
  /// Names must be unique: they key the saved moments.
  explicit Adam(std::vector<NamedTensor> parameters, const AdamOptions& options = {});

  /// One step at learning_rate * rate_factor (nn/schedule.h). A parameter without gradient is left as it is,
  /// and its own step count too.
  void step(double rate_factor = 1.0);
  void zero_grad();

  const AdamOptions& options() const { return options_; }
  const std::vector<NamedTensor>& parameters() const { return parameters_; }
  /// Number of calls of step() (and of the saved state it went on from).
  int64_t step_count() const { return *step_count_.tensor.data<int64_t>(); }

  /// For each parameter `exp_avg.<name>`, `exp_avg_sq.<name>` and int64 `step.<name>`; and int64
  /// `step_count`. The live moments, not copies.
  TensorMap state_dict() const;
  /// Overwrites in place; throws Error with the full difference where names or shapes are not this
  /// optimiser's, or where values are not finite.
  void load_state_dict(const TensorMap& state, const std::string& source = "optimiser state");

 private:
  AdamOptions options_;
  std::vector<NamedTensor> parameters_;
  std::vector<NamedTensor> moments1_, moments2_, steps_;
  NamedTensor step_count_{"step_count", Tensor::zeros({}, DType::kInt64)};

  std::vector<NamedTensor> named_state() const;
};

/// sqrt of the sum of squares of all gradients, in float64 and a fixed order; NaN or infinite where one is.
double gradient_norm(const std::vector<NamedTensor>& parameters);

}  // namespace opaline
