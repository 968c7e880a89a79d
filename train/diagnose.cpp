#include "train/diagnose.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <utility>

#include "core/autograd.h"
#include "nn/state.h"
#include "train/graph.h"

namespace opaline {
namespace {

bool finite(const Tensor& tensor) {
  return !tensor.defined() || !tensor.is_floating() || all_finite(tensor);
}

}  // namespace

std::string first_non_finite(const Tensor& root, const std::vector<NamedTensor>& parameters) {
  std::map<const void*, std::string> names;
  for (const NamedTensor& parameter : parameters) names[parameter.tensor.id()] = parameter.name;

  std::string last_parameter;
  for (const Tensor& edge : computation_order(root)) {
    const Tensor tensor = edge.restored();
    if (!tensor.defined()) continue;  // nothing kept its values
    const auto name = names.find(tensor.id());
    if (name != names.end()) last_parameter = name->second;
    if (finite(tensor)) continue;
    if (name != names.end()) return "the parameter " + name->second;
    const Node* const node = tensor.node().get();
    if (node == nullptr) return "a network input or target " + to_string(tensor.shape());
    std::string layer;
    for (const Tensor& input : node->inputs) {
      const auto found = input.defined() ? names.find(input.id()) : names.end();
      if (found != names.end() && layer.empty()) layer = " with " + found->second;
    }
    if (layer.empty() && !last_parameter.empty()) layer = " after " + last_parameter;
    return std::string(node->operation) + layer + ", result " + to_string(tensor.shape());
  }
  return {};
}

std::string first_non_finite(const Batch& batch) {
  const std::pair<const char*, const Tensor*> tensors[] = {{"input", &batch.input},
                                                           {"normal", &batch.normal},
                                                           {"depth", &batch.depth},
                                                           {"illumination", &batch.illumination},
                                                           {"sss", &batch.sss},
                                                           {"bsdf", &batch.bsdf},
                                                           {"polarised", &batch.polarised}};
  for (const auto& [name, tensor] : tensors) {
    if (finite(*tensor)) continue;
    const std::span<const float> values = tensor->values<float>();
    const size_t each = values.size() / static_cast<size_t>(batch.size());
    std::vector<std::string> scenes;
    for (size_t n = 0; n < batch.ids.size(); ++n) {
      const auto image = values.subspan(n * each, each);
      if (!std::all_of(image.begin(), image.end(), [](float v) { return std::isfinite(v); })) {
        scenes.push_back(batch.ids[n]);
      }
    }
    return fmt::format("the {} of {}", name, fmt::join(scenes, ", "));
  }
  return {};
}

std::string first_non_finite_gradient(const std::vector<NamedTensor>& parameters) {
  for (auto parameter = parameters.rbegin(); parameter != parameters.rend(); ++parameter) {
    if (!finite(parameter->tensor.grad())) return parameter->name;
  }
  return {};
}

}  // namespace opaline
