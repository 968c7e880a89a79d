#include "core/check/run.h"

#include <algorithm>
#include <cmath>

#include "core/autograd.h"

namespace opaline::check {
namespace {

// Agreed with scripts/golden/ops.py.
constexpr int64_t kWholeTensor = 256;
constexpr int64_t kSampleStride = 37;

// A gradient that is zero in exact arithmetic (of a bias before a norm) is measured against this share of the
// largest number in the run.
constexpr double kFloor = 1e-3;

double gradient_floor(const CaseRun& run) {
  double largest = largest_magnitude(Array(run.y));
  for (const Tensor& gradient : run.gradients) {
    if (gradient.defined()) largest = std::max(largest, largest_magnitude(Array(gradient)));
  }
  return kFloor * largest;
}

std::vector<Tensor> updated_inputs(const OpCase& op_case, std::span<const Tensor> inputs) {
  std::vector<Tensor> updated;
  for (size_t i = 0; i < inputs.size(); ++i) {
    if (op_case.inputs[i].updated) updated.push_back(inputs[i].detach());
  }
  return updated;
}

double tensor_golden_error(const OpCase& op_case, const std::string& what, const Tensor& tensor, double floor,
                           const TensorMap& golden) {
  const std::string key = std::string(op_case.variant()) + "/" + what;
  const auto find = [&](const std::string& name) -> const Tensor& {
    const auto found = golden.find(name);
    if (found == golden.end()) {
      fail(op_case.name, "has no golden value '{}'; run scripts/golden/ops.py", name);
    }
    return found->second;
  };
  const Array actual(tensor);
  if (actual.count() <= kWholeTensor) return relative_error(actual, Array(find(key)), floor);
  Array sample({(actual.count() + kSampleStride - 1) / kSampleStride});
  double squares = 0.0;
  for (int64_t i = 0; i < actual.count(); ++i) {
    if (i % kSampleStride == 0) sample[i / kSampleStride] = actual[i];
    squares += actual[i] * actual[i];
  }
  Array norm{Shape{}};
  norm[0] = std::sqrt(squares);
  double worst = relative_error(sample, Array(find(key + ".sample")), floor);
  include_error(worst, relative_error(norm, Array(find(key + ".norm")), floor));
  return worst;
}

}  // namespace

CaseRun run_case(const OpCase& op_case, DType dtype, double scale) {
  std::vector<Tensor> inputs = make_inputs(op_case, dtype);
  for (Tensor& input : inputs) {
    if (scale == 1.0 || !input.requires_grad()) continue;
    dispatch_floating(op_case.name, dtype, [&]<class T>() {
      for (T& v : input.values<T>()) v *= static_cast<T>(scale);
    });
  }
  CaseRun run;
  const Tensor y = op_case.forward(inputs);
  run.y = y.detach();
  run.updated = updated_inputs(op_case, inputs);
  if (y.requires_grad()) backward(y, make_cotangent(op_case, y.shape(), dtype));
  for (size_t i = 0; i < inputs.size(); ++i) {
    Tensor grad;
    if (op_case.inputs[i].differentiable) {
      grad = inputs[i].grad();
      if (!grad.defined()) grad = Tensor::zeros(inputs[i].shape(), dtype);
    }
    run.gradients.push_back(grad);
  }
  return run;
}

double reference_error(const OpCase& op_case, const CaseRun& run) {
  const std::vector<Tensor> inputs = make_inputs(op_case, DType::kFloat64);
  const std::vector<Array> arrays(inputs.begin(), inputs.end());
  const ReferenceResult expected = op_case.reference(arrays);
  double worst = relative_error(Array(run.y), expected.y);
  if (run.updated.size() != expected.updated.size()) {
    fail(op_case.name, "updates {} inputs, its reference {}", run.updated.size(), expected.updated.size());
  }
  for (size_t i = 0; i < run.updated.size(); ++i) {
    include_error(worst, relative_error(Array(run.updated[i]), expected.updated[i]));
  }
  return worst;
}

double gradient_difference(const CaseRun& run, const CaseRun& expected) {
  const double floor = gradient_floor(expected);
  double worst = 0.0;
  for (size_t i = 0; i < run.gradients.size(); ++i) {
    if (!run.gradients[i].defined()) continue;
    include_error(worst, relative_error(Array(run.gradients[i]), Array(expected.gradients[i]), floor));
  }
  return worst;
}

std::vector<GradientError> gradient_errors(const OpCase& op_case, const GradientOptions& options) {
  if (!op_case.smooth) return {};
  const std::vector<Tensor> inputs = make_inputs(op_case, DType::kFloat64);
  const Tensor y = op_case.forward(inputs);
  const Tensor cotangent = make_cotangent(op_case, y.shape(), DType::kFloat64);
  backward(y, cotangent);
  const Tensor before = y.clone();  // reshape's result shares the input's storage
  std::vector<Leaf> leaves;
  for (size_t i = 0; i < inputs.size(); ++i) {
    if (op_case.inputs[i].differentiable) leaves.push_back({op_case.inputs[i].name, inputs[i]});
  }
  const auto loss = [&] {
    const NoGradGuard no_grad;
    const Tensor now = op_case.forward(inputs);
    double sum = 0.0;
    for (int64_t i = 0; i < now.numel(); ++i) {
      sum += (now.data<double>()[i] - before.data<double>()[i]) * cotangent.data<double>()[i];
    }
    return sum;
  };
  return check_gradients(loss, leaves, options);
}

double golden_error(const OpCase& op_case, const CaseRun& run, const TensorMap& golden) {
  const double floor = gradient_floor(run);
  double worst = tensor_golden_error(op_case, "y", run.y, 0.0, golden);
  size_t updated = 0;
  for (size_t i = 0; i < op_case.inputs.size(); ++i) {
    const InputSpec& spec = op_case.inputs[i];
    if (spec.differentiable) {
      include_error(worst,
                    tensor_golden_error(op_case, "grad." + spec.name, run.gradients[i], floor, golden));
    }
    if (spec.updated) {
      include_error(
          worst, tensor_golden_error(op_case, "updated." + spec.name, run.updated[updated++], 0.0, golden));
    }
  }
  return worst;
}

}  // namespace opaline::check
