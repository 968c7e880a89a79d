#include "core/check/stress_scale.h"

#include <algorithm>
#include <cmath>
#include <limits>

namespace opaline::check {
namespace {

/// What an error of an element is relative to.
enum class Scale {
  kElement,       ///< the element: it comes of one rounding, or of a few that do not cancel
  kTerms,         ///< the sum of its terms' magnitudes: the operation on the inputs' magnitudes
  kLargestTerms,  ///< the largest such sum of the tensor: Winograd's tiles mix their pixels
  kLargest,       ///< the largest element of the tensor
};

struct Scales {
  Scale forward, backward;
};

// Every operation of the registry; the tests fail where one is missing.
const Scales& scales_of(std::string_view operation) {
  constexpr Scales kMoves{Scale::kElement, Scale::kElement};
  constexpr Scales kCopies{Scale::kElement, Scale::kTerms};  // the gradient is a sum
  constexpr Scales kSums{Scale::kTerms, Scale::kTerms};
  constexpr Scales kWholes{Scale::kLargest, Scale::kLargest};
  static const std::map<std::string_view, Scales> table = {
      {"conv2d", {Scale::kLargestTerms, Scale::kLargestTerms}},
      {"conv_transpose2d", kSums},
      {"reflection_pad2d", kCopies},
      {"linear", kSums},
      {"matmul", kSums},
      {"scaled_dot_product_attention", kWholes},
      {"layer_norm", kWholes},
      {"batch_norm", kWholes},
      {"instance_norm", kWholes},
      {"relu", kMoves},
      {"leaky_relu", kMoves},
      {"gelu", kSums},  // x (1 + erf(x / sqrt 2)) / 2 cancels for negative x
      {"tanh", {Scale::kElement, Scale::kLargest}},
      {"sigmoid", {Scale::kElement, Scale::kLargest}},
      {"softmax", kWholes},
      {"abs", kMoves},
      {"square", kMoves},
      {"safe_sqrt", kMoves},
      {"clamp", kMoves},
      {"normalize", kWholes},
      {"add", kCopies},
      {"sub", kCopies},
      {"mul", kCopies},
      {"div", kCopies},
      {"affine", kMoves},
      {"max_pool2d", kMoves},
      {"adaptive_avg_pool2d", kSums},
      {"upsample_bilinear", kWholes},  // weights round with their positions
      {"upsample_nearest", kCopies},
      {"sum", kSums},
      {"mean", kSums},
      {"concat", kMoves},
      {"reshape", kMoves},
      {"permute", kMoves},
      {"slice", kMoves},
      {"expand", kCopies},
      {"to_nhwc", kMoves},
      {"to_nchw", kMoves},
      {"masked_l1_loss", kMoves},
      {"masked_mse_loss", kMoves},
      {"cosine_loss", kWholes},
      {"l1_loss", kMoves},
      {"mse_loss", kMoves},
  };
  const auto found = table.find(operation);
  if (found == table.end()) {
    fail(std::string(operation), "has no entry in the table of scales of core/check/stress_scale.cpp");
  }
  return found->second;
}

Fill magnitudes(const Fill& fill) {
  return [fill](std::span<double> values, Random& random) {
    fill(values, random);
    for (double& v : values) v = std::abs(v);
  };
}

/// Largest 1 / sqrt(variance + 1e-5) of the values that one statistic of a normalisation is taken over.
double largest_inverse_deviation(std::string_view operation, const Array& x) {
  const int64_t channels = x.last();
  const int64_t image = x.count() / (x.shape.size() == 4 ? x.size(0) : 1);
  const auto group = [&](int64_t i) {
    if (operation == "layer_norm") return i / channels;
    return operation == "batch_norm" ? i % channels : i / image * channels + i % channels;
  };
  std::map<int64_t, std::vector<double>> groups;
  for (int64_t i = 0; i < x.count(); ++i) groups[group(i)].push_back(x[i]);
  double smallest = std::numeric_limits<double>::infinity();
  for (const auto& [index, values] : groups) {
    const auto n = static_cast<double>(values.size());
    double mean = 0.0, variance = 0.0;
    for (const double v : values) mean += v / n;
    for (const double v : values) variance += (v - mean) * (v - mean) / n;
    if (variance < smallest) smallest = variance;
  }
  return 1.0 / std::sqrt(smallest + 1e-5);
}

double attention_depth(const OpCase& op_case, const Array& query) {
  return static_cast<double>(query.last()) / std::stod(op_case.options.at("heads"));
}

/// How far an attention's scores, rounded relative to their terms, carry an error into its weights: by a
/// factor of 1 + the largest score that the magnitudes allow.
double attention_condition(const OpCase& op_case, std::span<const Array> inputs) {
  return 1.0 + largest_magnitude(inputs[0]) * largest_magnitude(inputs[1]) *
                   std::sqrt(attention_depth(op_case, inputs[0]));
}

/// The same for a gradient: dP = dy value^T, dS = P (dP - sum dP P), then a product with the other factor.
double attention_gradient(const OpCase& op_case, const std::string& input, std::span<const Array> inputs,
                          double cotangent) {
  const double condition = attention_condition(op_case, inputs);
  const auto queries = static_cast<double>(inputs[0].size(1));
  if (input == "value") return condition * cotangent * queries;
  const double scores =
      cotangent * largest_magnitude(inputs[2]) * std::sqrt(attention_depth(op_case, inputs[0]));
  return condition * scores *
         (input == "query" ? largest_magnitude(inputs[1]) : queries * largest_magnitude(inputs[0]));
}

/// The size of gradient that the terms of an operation's backward pass have where they may cancel to nothing,
/// as a normalisation's do for a gradient along its input.
double gradient_floor(const OpCase& op_case, const std::string& input, std::span<const Array> inputs,
                      double cotangent) {
  const std::string_view operation = op_case.operation();
  if (operation == "tanh" || operation == "sigmoid" || operation == "softmax") return cotangent;
  if (operation == "normalize" || operation == "cosine_loss") {
    const double x = largest_magnitude(inputs[0]);
    const auto terms = static_cast<double>(operation == "normalize" ? 1 : inputs[2].count());
    return x > 0.0 ? cotangent / x / terms : 0.0;
  }
  if (operation == "scaled_dot_product_attention")
    return attention_gradient(op_case, input, inputs, cotangent);
  if (!operation.ends_with("_norm")) return 0.0;
  if (input != "x") return cotangent;
  const bool constants = op_case.options.contains("training") && op_case.options.at("training") == "false";
  const double weight = inputs.size() > 1 ? largest_magnitude(inputs[1]) : 1.0;
  return constants ? 0.0 : cotangent * weight * largest_inverse_deviation(operation, inputs[0]);
}

/// The same for a result: where 1 - cosine cancels, and where values equal their mean.
double result_floor(const OpCase& op_case, std::span<const Array> inputs) {
  if (op_case.operation() == "cosine_loss") return 1.0;
  if (op_case.operation() == "scaled_dot_product_attention") {
    return largest_magnitude(inputs[2]) * attention_condition(op_case, inputs);
  }
  if (!op_case.operation().ends_with("_norm")) return 0.0;
  return inputs.size() > 1 ? largest_magnitude(inputs[1]) : 1.0;
}

Array one_number(double value) {
  Array result{Shape{}};
  result[0] = value;
  return result;
}

}  // namespace

bool computable(const OpCase& op_case, std::span<const Array> inputs) {
  if (op_case.operation() != "scaled_dot_product_attention") return true;
  return attention_condition(op_case, inputs) * std::sqrt(attention_depth(op_case, inputs[0])) <
         static_cast<double>(std::numeric_limits<float>::max());
}

OpCase on_magnitudes(OpCase op_case) {
  for (InputSpec& input : op_case.inputs) input.fill = magnitudes(input.fill);
  op_case.cotangent = magnitudes(op_case.cotangent);
  return op_case;
}

Array error_scale(const OpCase& op_case, const std::string& name, const Array& value, const Array& terms,
                  std::span<const Array> inputs, double cotangent) {
  const bool gradient = name.starts_with("grad.");
  const Scales& scales = scales_of(op_case.operation());
  double floor = 0.0;
  if (gradient) floor = gradient_floor(op_case, name.substr(5), inputs, cotangent);
  if (name == "y") floor = result_floor(op_case, inputs);
  switch (gradient ? scales.backward : scales.forward) {
    case Scale::kElement:
      return value;
    case Scale::kTerms:
      return terms;
    case Scale::kLargestTerms:
      return one_number(largest_magnitude(terms));
    case Scale::kLargest:
      return one_number(std::max(largest_magnitude(value), floor));
  }
  return value;
}

}  // namespace opaline::check
