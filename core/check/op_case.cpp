#include "core/check/op_case.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <numeric>

#include "core/autograd.h"
#include "core/file.h"
#include "core/safetensors.h"

namespace opaline::check {
namespace fill {

Fill normal(double scale, double offset) {
  return [=](std::span<double> values, Random& random) {
    for (double& v : values) v = offset + scale * random.normal();
  };
}

Fill uniform(double low, double high) {
  return [=](std::span<double> values, Random& random) {
    for (double& v : values) v = random.uniform(low, high);
  };
}

Fill away_from(std::vector<double> points, double margin) {
  return [=](std::span<double> values, Random& random) {
    const auto near = [&](double v) {
      return std::any_of(points.begin(), points.end(), [&](double p) { return std::abs(v - p) < margin; });
    };
    for (double& v : values) {
      do {
        v = random.normal();
      } while (near(v));
    }
  };
}

Fill distinct() {
  return [](std::span<double> values, Random& random) {
    std::vector<int64_t> order(values.size());
    std::iota(order.begin(), order.end(), 0);
    shuffle(order, random);
    for (size_t i = 0; i < order.size(); ++i) {
      values[i] = (2.0 * static_cast<double>(order[i]) + 1.0) / static_cast<double>(order.size()) - 1.0;
    }
  };
}

Fill mask(double coverage, int64_t empty) {
  return [=](std::span<double> values, Random& random) {
    for (double& v : values) v = random.uniform() < coverage ? 1.0 : 0.0;
    std::fill_n(values.begin(), std::min<size_t>(static_cast<size_t>(empty), values.size()), 0.0);
  };
}

Fill values(std::vector<double> list) {
  return [list = std::move(list)](std::span<double> values, Random&) {
    for (size_t i = 0; i < values.size(); ++i) values[i] = list[i % list.size()];
  };
}

}  // namespace fill

namespace {

Tensor draw(const OpCase& op_case, const Fill& fill, const Shape& shape, uint32_t index, DType dtype) {
  const uint64_t seed = xxh64(std::as_bytes(std::span(op_case.name.data(), op_case.name.size())));
  Random random(seed, Purpose::kTest, 0, index);
  Tensor tensor(shape, DType::kFloat64);
  fill(tensor.values<double>(), random);
  for (double& v : tensor.values<double>()) v = static_cast<double>(static_cast<float>(v));
  return tensor.to(dtype);
}

}  // namespace

const std::vector<OpCase>& op_cases() {
  static const std::vector<OpCase> cases = [] {
    std::vector<OpCase> all;
    for (const auto family :
         {conv_cases, linear_cases, norm_cases, activation_cases, unary_cases, arithmetic_cases, pool_cases,
          resize_cases, reduce_cases, shape_cases, loss_cases, sites_cases}) {
      for (OpCase& op_case : family()) all.push_back(std::move(op_case));
    }
    return all;
  }();
  return cases;
}

std::vector<OpCase> large_op_cases(int64_t side) {
  std::vector<OpCase> all;
  for (const auto family : {large_conv_cases, large_linear_cases, large_norm_cases, large_pointwise_cases,
                            large_spatial_cases, large_shape_cases, large_loss_cases}) {
    for (OpCase& op_case : family(side)) all.push_back(std::move(op_case));
  }
  return all;
}

std::vector<Tensor> make_inputs(const OpCase& op_case, DType dtype) {
  std::vector<Tensor> inputs;
  for (const InputSpec& spec : op_case.inputs) {
    inputs.push_back(draw(op_case, spec.fill, spec.shape, static_cast<uint32_t>(inputs.size()), dtype));
    if (spec.differentiable) inputs.back().set_requires_grad(true);
  }
  return inputs;
}

Tensor make_cotangent(const OpCase& op_case, const Shape& shape, DType dtype) {
  return draw(op_case, op_case.cotangent, shape, static_cast<uint32_t>(op_case.inputs.size()), dtype);
}

std::string describe(const OpCase& op_case) {
  nlohmann::json description = {{"options", nlohmann::json::object()},
                                {"inputs", nlohmann::json::array()},
                                {"differentiable", nlohmann::json::array()},
                                {"updated", nlohmann::json::array()}};
  for (const auto& [key, value] : op_case.options) {
    description["options"][key] = nlohmann::json::parse(value);
  }
  for (const InputSpec& spec : op_case.inputs) {
    description["inputs"].push_back(spec.name);
    if (spec.differentiable) description["differentiable"].push_back(spec.name);
    if (spec.updated) description["updated"].push_back(spec.name);
  }
  return description.dump();
}

void write_case_inputs(const std::filesystem::path& path) {
  TensorMap tensors;
  std::map<std::string, std::string> metadata;
  const NoGradGuard no_grad;
  for (const OpCase& op_case : op_cases()) {
    if (!op_case.in_pytorch) continue;
    const std::vector<Tensor> inputs = make_inputs(op_case, DType::kFloat32);
    for (size_t i = 0; i < inputs.size(); ++i) {
      tensors[op_case.name + "/" + op_case.inputs[i].name] = inputs[i].clone();
    }
    const Shape shape = op_case.forward(inputs).shape();
    tensors[op_case.name + "/cotangent"] = make_cotangent(op_case, shape, DType::kFloat32);
    metadata[op_case.name] = describe(op_case);
  }
  save_safetensors(path, tensors, metadata);
}

}  // namespace opaline::check
