// Naive float64 references: the definition of each operation written as plainly as it can be, one value at a
// time, on arrays that share nothing with the engine. Slow on purpose; what they are for is being right.
// Layouts, options and formulas are those of the operations in core/ops.
#pragma once

#include <functional>
#include <optional>
#include <span>
#include <vector>

#include "core/check/array.h"

namespace opaline::check::reference {

// Pointwise.
Array map(const Array& x, const std::function<double(double)>& f);
double relu(double x);
double leaky_relu(double x, double slope);
double gelu(double x);
double tanh(double x);
double sigmoid(double x);
double safe_sqrt(double x);
double clamp(double x, double low, double high);
/// f(a, b) with NumPy's broadcasting.
Array broadcast(const Array& a, const Array& b, const std::function<double(double, double)>& f);

// Over the last dimension.
Array softmax(const Array& x);
Array normalize(const Array& x, double eps);

// Convolutions and products.
struct ConvParameters {
  int64_t stride = 1;
  int64_t padding = 0;
  bool reflect = false;
};
Array conv2d(const Array& x, const Array& weight, const std::optional<Array>& bias,
             const ConvParameters& parameters);
Array conv_transpose2d(const Array& x, const Array& weight, const std::optional<Array>& bias,
                       const ConvParameters& parameters);
Array reflection_pad2d(const Array& x, int64_t padding);
Array linear(const Array& x, const Array& weight, const std::optional<Array>& bias);
Array attention(const Array& query, const Array& key, const Array& value, int64_t heads);
Array matmul(const Array& a, const Array& b, bool transpose_a, bool transpose_b);

// Normalisations; an absent weight and bias are ones and zeros.
Array layer_norm(const Array& x, const Array& weight, const Array& bias, double eps);
struct BatchNormResult {
  Array y, running_mean, running_var;
};
BatchNormResult batch_norm(const Array& x, const Array& weight, const Array& bias, const Array& running_mean,
                           const Array& running_var, bool training, double momentum, double eps);
Array instance_norm(const Array& x, const std::optional<Array>& weight, const std::optional<Array>& bias,
                    double eps);

// Pooling and resampling.
Array max_pool2d(const Array& x, int64_t kernel);
Array adaptive_avg_pool2d(const Array& x, int64_t height, int64_t width);
Array upsample_bilinear(const Array& x, int64_t height, int64_t width, bool align_corners);
Array upsample_nearest(const Array& x, int64_t height, int64_t width);

// Reductions: over everything, or over one dimension (counted from the front).
Array sum(const Array& x);
Array mean(const Array& x);
Array sum(const Array& x, size_t axis, bool keepdim);
Array mean(const Array& x, size_t axis, bool keepdim);

// Moving elements.
Array concat(std::span<const Array> parts, size_t axis);
Array reshape(const Array& x, Shape shape);
Array permute(const Array& x, const std::vector<size_t>& order);
Array slice(const Array& x, size_t axis, int64_t begin, int64_t end);
Array expand(const Array& x, const Shape& shape);

// Losses; a pixel outside the mask is not looked at.
Array masked_l1_loss(const Array& x, const Array& target, const Array& mask);
Array masked_mse_loss(const Array& x, const Array& target, const Array& mask);
Array cosine_loss(const Array& x, const Array& target, const Array& mask);
Array l1_loss(const Array& x, const Array& target);
Array mse_loss(const Array& x, const Array& target);

}  // namespace opaline::check::reference
