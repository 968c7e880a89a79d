#include "core/check/gradient.h"

#include <algorithm>
#include <cmath>

#include "core/check/array.h"
#include "core/random.h"

namespace opaline::check {
namespace {

// A step changes the loss by about this much: far over rounding, small against the curvature and the distance
// to the next kink.
constexpr double kLossStep = 1e-5;
constexpr double kLargestStep = 3e-4;
constexpr double kShrink = 0.6;
// Quotients of a step and of half of it agree to this share of the scale where the function is smooth.
constexpr double kSmooth = 2e-7;
constexpr double kFloor = 1e-2;

double dot(const Tensor& a, const Tensor& b) {
  const double *p = a.data<double>(), *q = b.data<double>();
  double sum = 0.0;
  for (int64_t i = 0; i < a.numel(); ++i) sum += p[i] * q[i];
  return sum;
}

double largest(const Tensor& x) {
  double result = 0.0;
  for (const double v : x.values<double>()) result = std::max(result, std::abs(v));
  return result;
}

/// The middle one, of those that are not zero where there are any.
double median(std::vector<double> values) {
  std::erase(values, 0.0);
  if (values.empty()) return 0.0;
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

/// Derivative of the loss along a move of the leaf; NaN where it is not smooth there. `move(h)` puts the leaf
/// at `h` along the way.
double derivative(const std::function<double()>& loss, const std::function<void(double)>& move, double step,
                  double scale) {
  const auto quotient = [&](double h) {
    move(h);
    const double plus = loss();
    move(-h);
    return (plus - loss()) / (2.0 * h);
  };
  const double wide = quotient(step);
  const double narrow = quotient(step / 2.0);
  move(0.0);
  if (!(std::abs(wide - narrow) <= kSmooth * scale)) return std::nan("");
  return (4.0 * narrow - wide) / 3.0;
}

/// The gradient's own direction, where the signal is, plus a random one of the same length, so that an error
/// in any element shows.
Tensor draw_direction(const Tensor& grad, Random& random) {
  Tensor direction(grad.shape(), DType::kFloat64);
  for (double& v : direction.values<double>()) v = random.uniform(-1.0, 1.0);
  const double random_norm = std::sqrt(dot(direction, direction));
  const double grad_norm = std::sqrt(dot(grad, grad));
  for (int64_t i = 0; i < grad.numel(); ++i) {
    double& v = direction.data<double>()[i];
    v = v / random_norm + (grad_norm > 0.0 ? grad.data<double>()[i] / grad_norm : 0.0);
  }
  return direction;
}

struct Typical {
  double norm, element;
};

class LeafCheck {
 public:
  LeafCheck(const std::function<double()>& loss, const Leaf& leaf, uint32_t index, const Typical& typical,
            const GradientOptions& options)
      : loss_(loss), leaf_(leaf), grad_(leaf.tensor.grad()), typical_(typical), options_(options) {
    if (!grad_.defined()) grad_ = Tensor::zeros(leaf.tensor.shape(), DType::kFloat64);
    random_ = Random(options.seed, Purpose::kTest, 1, index);
    result_.name = leaf.name;
    result_.norm = std::sqrt(dot(grad_, grad_));
  }

  GradientError run() {
    if (leaf_.tensor.numel() == 0) return result_;
    for (int64_t i = 0; i < options_.directions; ++i) probe([&](int draw) { return direction_error(draw); });
    const int64_t count = std::min(options_.elements, leaf_.tensor.numel());
    for (int64_t i = 0; i < count; ++i) {
      // Spread over the leaf; a redrawn element is a random one.
      const int64_t first = i * leaf_.tensor.numel() / count;
      probe([&](int draw) {
        const auto n = static_cast<uint32_t>(leaf_.tensor.numel());
        return element_error(draw == 0 ? first : static_cast<int64_t>(random_.below(n)), draw);
      });
    }
    return result_;
  }

 private:
  /// Draws until there is an error to speak of.
  template <class F>
  void probe(const F& error_of_draw) {
    double error = std::nan("");
    for (int draw = 0; draw < options_.max_draws && std::isnan(error); ++draw) {
      if (draw > 0) ++result_.redrawn;
      error = error_of_draw(draw);
    }
    include_error(result_.error, error);
  }

  double first_step(double scale) const { return options_.step * std::min(kLossStep / scale, kLargestStep); }

  double direction_error(int draw) {
    const Tensor direction = draw_direction(grad_, random_);
    double scale = std::max(result_.norm, kFloor * typical_.norm);
    if (scale == 0.0) scale = 1.0;
    const Tensor start = leaf_.tensor.clone();
    Tensor x = leaf_.tensor;
    const auto move = [&](double h) {
      for (int64_t i = 0; i < x.numel(); ++i) {
        x.data<double>()[i] = start.data<double>()[i] + h * direction.data<double>()[i];
      }
    };
    const double step = first_step(scale) * std::pow(kShrink, draw);
    return std::abs(derivative(loss_, move, step, scale) - dot(grad_, direction)) / scale;
  }

  double element_error(int64_t i, int draw) {
    const double expected = grad_.data<double>()[i];
    double scale = std::max(std::abs(expected), kFloor * std::max(largest(grad_), typical_.element));
    if (scale == 0.0) scale = 1.0;
    Tensor x = leaf_.tensor;
    const double start = x.data<double>()[i];
    const auto move = [&](double h) { x.data<double>()[i] = start + h; };
    const double step = first_step(scale) * std::pow(kShrink, draw);
    return std::abs(derivative(loss_, move, step, scale) - expected) / scale;
  }

  const std::function<double()>& loss_;
  const Leaf& leaf_;
  Tensor grad_;
  Typical typical_;
  GradientOptions options_;
  Random random_{0, Purpose::kTest};
  GradientError result_;
};

}  // namespace

std::vector<GradientError> check_gradients(const std::function<double()>& loss, std::span<const Leaf> leaves,
                                           const GradientOptions& options) {
  std::vector<double> norms, elements;
  for (const Leaf& leaf : leaves) {
    const Tensor grad = leaf.tensor.grad();
    norms.push_back(grad.defined() ? std::sqrt(dot(grad, grad)) : 0.0);
    elements.push_back(grad.defined() ? largest(grad) : 0.0);
  }
  const Typical typical{.norm = median(norms), .element = median(elements)};
  std::vector<GradientError> results;
  uint32_t index = 0;
  for (const Leaf& leaf : leaves) {
    results.push_back(LeafCheck(loss, leaf, index++, typical, options).run());
  }
  return results;
}

}  // namespace opaline::check
