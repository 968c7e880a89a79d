#include "train/check.h"

#include <algorithm>

#include "core/autograd.h"
#include "core/random.h"
#include "train/losses.h"

namespace opaline {
namespace {

constexpr int64_t kBatch = 4;
constexpr int64_t kSize = 32;
constexpr int64_t kWidth = 4;

Tensor uniform(Shape shape, uint32_t index, double low = -1.0, double high = 1.0) {
  Tensor tensor(std::move(shape), DType::kFloat64);
  Random random(2, Purpose::kTest, 2, index);
  for (double& v : tensor.values<double>()) v = random.uniform(low, high);
  return tensor;
}

/// Weights far enough from the recipe's that the illumination decoder's few ReLUs stay alive: its norms are
/// lifted a little.
void set_weights(Cascade& cascade) {
  uint32_t index = 100;
  for (NamedTensor& parameter : cascade.named_parameters()) {
    Tensor& tensor = parameter.tensor;
    const bool scale = tensor.dim() == 1 && parameter.name.ends_with("weight");
    const double spread = tensor.dim() > 1 ? 0.14 : 0.2;
    const double center = scale ? 1.0 : tensor.dim() == 1 ? 0.2 : 0.0;
    tensor.copy_from(uniform(tensor.shape(), index++, center - spread, center + spread));
  }
}

}  // namespace

std::vector<check::GradientError> config_gradient_errors(const RunConfig& config, int stage,
                                                         const check::GradientOptions& options) {
  CascadeOptions sizes = cascade_options(config, stage);
  sizes.network.image_size = kSize;
  sizes.network.width = kWidth;
  sizes.network.dtype = DType::kFloat64;
  Cascade cascade(sizes);
  set_weights(cascade);
  cascade.set_training(true);
  for (const std::string& name : config.stages[static_cast<size_t>(stage - 1)].freeze) {
    if (!cascade.has(name)) continue;
    cascade.network(name).set_training(false);
    cascade.network(name).set_requires_grad(false);
  }

  const Variant variant = sizes.network.variant;
  Tensor mask = uniform({kBatch, kSize, kSize, 1}, 2);
  for (double& v : mask.values<double>()) v = v < 0.2 ? 1.0 : 0.0;
  const CascadeInput input{.image = uniform({kBatch, kSize, kSize, sizes.network.input_channels}, 0),
                           .bsdf = uniform({kBatch, kSize, kSize, kBsdfChannels}, 1),
                           .mask = mask};
  const LossTargets targets{.mask = mask,
                            .normal = uniform({kBatch, kSize, kSize, 3}, 3),
                            .depth = uniform({kBatch, kSize, kSize, 1}, 4),
                            .illumination = uniform({kBatch, illumination_values(variant)}, 5),
                            .sss = uniform({kBatch, sss_values(variant)}, 6),
                            .reconstruction = uniform({kBatch, kSize, kSize, kBsdfChannels}, 7)};
  const CascadeWanted wanted = wanted_outputs(config.loss, sizes);
  const auto losses = [&] { return compute_losses(config.loss, cascade.forward(input, wanted), targets); };

  const Losses before = losses();
  backward(before.total);
  std::vector<check::Leaf> leaves;
  for (const NamedTensor& parameter : cascade.named_parameters()) {
    if (parameter.tensor.grad().defined()) leaves.push_back({parameter.name, parameter.tensor});
  }
  const auto loss = [&] {
    // Term by term: in the total the digits of a small one are lost.
    const NoGradGuard no_grad;
    const Losses now = losses();
    double change = 0.0;
    for (size_t i = 0; i < now.terms.size(); ++i) {
      const LossValue& term = now.terms[i];
      change += loss_term(config.loss, term.name).weight * (term.value.item() - before.terms[i].value.item());
    }
    return change;
  };
  return check::check_gradients(loss, leaves, options);
}

}  // namespace opaline
