#include "core/check/stress.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <nlohmann/json.hpp>

#include "core/check/stress_scale.h"
#include "core/safetensors.h"

namespace opaline::check {
namespace {

constexpr double kLargestFloat = std::numeric_limits<float>::max();
constexpr double kSmallestFloat = std::numeric_limits<float>::min();

bool in_float_range(double value) {
  return std::abs(value) <= kLargestFloat;
}

/// The results of a run by name; calls visit(name, tensor).
template <class F>
void visit_results(const OpCase& op_case, const CaseRun& run, const F& visit) {
  visit("y", run.y);
  size_t updated = 0;
  for (size_t i = 0; i < op_case.inputs.size(); ++i) {
    const InputSpec& input = op_case.inputs[i];
    if (input.updated) visit("updated." + input.name, run.updated[updated++]);
    if (input.differentiable) visit("grad." + input.name, run.gradients[i]);
  }
}

bool is_gradient(const std::string& name) {
  return name.starts_with("grad.");
}

}  // namespace

void StressError::include(const StressError& other) {
  value = std::max(value, other.value);
  lost = lost || other.lost;
}

StressError Expected::error(const Array& actual, bool may_lose) const {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  if (actual.shape != value.shape) return {.value = kInfinity};
  StressError worst;
  for (int64_t i = 0; i < value.count(); ++i) {
    const double a = actual[i], e = value[i];
    double size = std::max(std::abs(scale[scale.count() == 1 ? 0 : i]), kSmallestFloat);
    if (!std::isfinite(size)) size = std::max(std::abs(e), kSmallestFloat);
    if (!std::isfinite(e)) {
      if (std::isfinite(a)) worst.value = kInfinity;
    } else if (std::isfinite(a)) {
      worst.value = std::max(worst.value, std::abs(a - e) / size);
    } else if (in_float_range(e) && in_float_range(size) && !may_lose) {
      worst.lost = true;
    }
  }
  return worst;
}

StressCase::StressCase(const OpCase& op_case, const Regime& regime) : case_(stressed(op_case, regime)) {
  const NumericsGuard direct(Numerics::kStrict);
  const std::vector<Tensor> tensors = make_inputs(case_, DType::kFloat64);
  const std::vector<Array> inputs(tensors.begin(), tensors.end());
  const CaseRun wide = run_case(case_, DType::kFloat64);
  const CaseRun terms = run_case(on_magnitudes(case_), DType::kFloat64);
  const Array cotangents(make_cotangent(case_, wide.y.shape(), DType::kFloat64));
  const double cotangent = largest_magnitude(cotangents);
  visit_results(case_, wide, [&](const std::string& name, const Tensor& tensor) {
    expected_[name].value = Array(tensor);
  });
  // Values are the naive reference's, gradients those of the operation itself in float64.
  ReferenceResult reference = case_.reference(inputs);
  expected_.at("y").value = std::move(reference.y);
  size_t updated = 0;
  for (const InputSpec& input : case_.inputs) {
    if (input.updated) expected_.at("updated." + input.name).value = std::move(reference.updated[updated++]);
  }
  visit_results(case_, terms, [&](const std::string& name, const Tensor& tensor) {
    Expected& e = expected_.at(name);
    e.scale = error_scale(case_, name, e.value, Array(tensor), inputs, cotangent);
  });
  const auto in_range = [](const Array& array) { return std::ranges::all_of(array.values, in_float_range); };
  in_range_ = in_range(cotangents) && std::ranges::all_of(inputs, in_range) &&
              std::ranges::all_of(expected_, [&](const auto& entry) { return in_range(entry.second.value); });
  computable_ = computable(case_, inputs);
}

StressErrors StressCase::run(Numerics numerics) const {
  const NumericsGuard guard(numerics);
  // Winograd's algorithm spreads what is no number over a tile, and interpolation, as PyTorch's, to a
  // neighbour of weight 0.
  const bool spreads = case_.operation() == "upsample_bilinear" ||
                       (case_.operation() == "conv2d" && numerics != Numerics::kStrict);
  StressErrors errors;
  if (!computable_) return errors;
  visit_results(case_, run_case(case_, DType::kFloat32), [&](const std::string& name, const Tensor& tensor) {
    StressError& side = is_gradient(name) ? errors.backward : errors.forward;
    side.include(expected_.at(name).error(Array(tensor), spreads && !in_range_));
  });
  return errors;
}

std::vector<StressSummary> run_stress(
    Numerics numerics, const std::function<void(const StressCase&, const StressErrors&)>& each) {
  std::vector<StressSummary> summaries;
  for (const OpCase& op_case : op_cases()) {
    if (!op_case.in_pytorch) continue;  // on active sites the arithmetic is that of whole images
    auto found = std::ranges::find(summaries, op_case.operation(), &StressSummary::operation);
    if (found == summaries.end()) {
      summaries.push_back({.operation = std::string(op_case.operation())});
      found = std::prev(summaries.end());
    }
    StressSummary& summary = *found;
    for (const Regime& regime : stress_regimes()) {
      const StressCase stress(op_case, regime);
      const StressErrors errors = stress.run(numerics);
      ++summary.cases;
      if (errors.forward.lost || errors.backward.lost) ++summary.lost;
      const auto include = [&](const StressError& error, StressError& worst, std::string& where) {
        if (where.empty() || error.value > worst.value) where = stress.op_case().variant();
        worst.include(error);
      };
      include(errors.forward, summary.worst.forward, summary.forward_case);
      include(errors.backward, summary.worst.backward, summary.backward_case);
      if (each) each(stress, errors);
    }
  }
  return summaries;
}

std::vector<StressSummary> export_stress(Numerics numerics, const std::filesystem::path& folder) {
  std::filesystem::create_directories(folder);
  struct File {
    TensorMap tensors;
    std::map<std::string, std::string> metadata;
  };
  std::map<std::string, File, std::less<>> files;
  const auto to_tensor = [](const Array& array) {
    return Tensor::from(std::span<const double>(array.values), array.shape);
  };
  std::vector<StressSummary> summaries = run_stress(numerics, [&](const StressCase& stress,
                                                                  const StressErrors& errors) {
    const OpCase& op_case = stress.op_case();
    auto& [tensors, metadata] = files[std::string(op_case.operation())];
    const std::vector<Tensor> inputs = make_inputs(op_case, DType::kFloat32);
    for (size_t i = 0; i < inputs.size(); ++i) {
      tensors[op_case.name + "/" + op_case.inputs[i].name] = inputs[i].detach();
    }
    const Shape& shape = stress.expected().at("y").value.shape;
    tensors[op_case.name + "/cotangent"] = make_cotangent(op_case, shape, DType::kFloat32);
    for (const auto& [name, expected] : stress.expected()) {
      tensors[op_case.name + "/expected." + name] = to_tensor(expected.value);
      tensors[op_case.name + "/scale." + name] = to_tensor(expected.scale);
    }
    nlohmann::json description = nlohmann::json::parse(describe(op_case));
    // JSON has no infinity.
    description["ours"] = {fmt::format("{}", errors.forward.value), fmt::format("{}", errors.backward.value)};
    description["lost"] = errors.forward.lost || errors.backward.lost;
    metadata[op_case.name] = description.dump();
  });
  for (const auto& [operation, file] : files) {
    save_safetensors(folder / (operation + ".safetensors"), file.tensors, file.metadata);
  }
  return summaries;
}

}  // namespace opaline::check
