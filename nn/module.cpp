#include "nn/module.h"

#include <algorithm>
#include <cmath>

#include "core/parallel.h"
#include "core/random.h"
#include "nn/state.h"

namespace opaline {

void Module::collect(const std::string& prefix, Kind kind, std::vector<NamedTensor>& out) const {
  const auto take = [&](const std::vector<NamedTensor>& entries) {
    for (const NamedTensor& entry : entries) {
      out.push_back({prefix + entry.name, entry.tensor, entry.initial});
    }
  };
  if (kind != Kind::kBuffers) take(parameters_);
  if (kind != Kind::kParameters) take(buffers_);
  for (const Child& child : children_) child.module->collect(prefix + child.name + ".", kind, out);
}

std::vector<NamedTensor> Module::named_parameters() const {
  std::vector<NamedTensor> result;
  collect("", Kind::kParameters, result);
  return result;
}

std::vector<NamedTensor> Module::named_buffers() const {
  std::vector<NamedTensor> result;
  collect("", Kind::kBuffers, result);
  return result;
}

std::vector<NamedTensor> Module::named_state() const {
  std::vector<NamedTensor> result;
  collect("", Kind::kBoth, result);
  return result;
}

int64_t Module::parameter_count() const {
  int64_t count = 0;
  for (const NamedTensor& parameter : named_parameters()) count += parameter.tensor.numel();
  return count;
}

TensorMap Module::state_dict() const {
  return to_map(named_state());
}

void Module::load_state_dict(const TensorMap& state, const LoadStateOptions& options) {
  load_state(named_state(), state, options);
}

void Module::set_training(bool on) {
  training_ = on;
  for (const Child& child : children_) child.module->set_training(on);
}

void Module::set_requires_grad(bool on) {
  for (NamedTensor& parameter : named_parameters()) parameter.tensor.set_requires_grad(on);
}

void Module::zero_grad() {
  for (NamedTensor& parameter : named_parameters()) parameter.tensor.zero_grad();
}

Tensor Module::add_parameter(std::string name, Shape shape, DType dtype, InitialValue initial) {
  Tensor tensor = Tensor::full(std::move(shape), initial.mean, dtype);
  tensor.set_requires_grad(true);
  parameters_.push_back({std::move(name), tensor, initial});
  return tensor;
}

Tensor Module::add_buffer(std::string name, Tensor value) {
  buffers_.push_back({std::move(name), value});
  return value;
}

void initialize(Module& module, uint64_t seed, uint32_t first_index) {
  std::vector<NamedTensor> parameters = module.named_parameters();
  parallel_for(static_cast<int64_t>(parameters.size()), [&](int64_t i) {
    const InitialValue initial = parameters[static_cast<size_t>(i)].initial;
    Tensor& tensor = parameters[static_cast<size_t>(i)].tensor;
    if (initial.deviation == 0.0) {
      tensor.fill(initial.mean);
      return;
    }
    Random random(seed, Purpose::kInit, 0, first_index + static_cast<uint32_t>(i));
    dispatch_floating("initialize", tensor.dtype(), [&]<class T>() {
      for (T& value : tensor.values<T>()) {
        value = static_cast<T>(initial.mean + initial.deviation * random.normal());
      }
    });
  });
}

}  // namespace opaline
