#include <cmath>
#include <limits>

#include "core/check/stress.h"

namespace opaline::check {
namespace {

/// Magnitudes even in the logarithm, signs at random.
Fill log_uniform(double low, double high) {
  return [=](std::span<double> values, Random& random) {
    for (double& v : values) {
      const double magnitude = std::exp(random.uniform(std::log(low), std::log(high)));
      v = random.below(2) == 0 ? magnitude : -magnitude;
    }
  };
}

/// Normal numbers but for one.
Fill with_one(double value) {
  return [value](std::span<double> values, Random& random) {
    fill::normal()(values, random);
    if (!values.empty()) values[random.below(static_cast<uint32_t>(values.size()))] = value;
  };
}

}  // namespace

const std::vector<Regime>& stress_regimes() {
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  const Fill tiny = fill::normal(1e-30), huge = fill::normal(1e30), one = fill::normal();
  const Fill wide = log_uniform(1e-30, 1e30), zeros = fill::values({0.0, -0.0, -0.0});
  const Fill saturated = fill::values({-1e4, -90.0, -40.0, 20.0, 0.5, -20.0, 40.0, 90.0, 1e4, 88.0, 17.0});
  static const std::vector<Regime> regimes = {
      {"normal", one},
      {"tiny", tiny},
      {"huge", huge},
      {"all_tiny", tiny, tiny},
      {"all_huge", huge, huge},
      {"tiny_by_huge", tiny, huge},
      {"huge_by_tiny", huge, tiny},
      {"wide", wide},
      {"all_wide", wide, wide},
      {"denormal", fill::normal(1e-40)},
      {"all_denormal", fill::normal(1e-40), fill::normal(1e-40)},
      {"constant", fill::values({3.7})},
      {"all_constant", fill::values({3.7}), fill::values({-0.3})},
      {"zeros", zeros},
      {"all_zeros", zeros, zeros},
      {"offset", fill::normal(1.0, 1e4)},
      {"far_offset", fill::normal(1e22, 1e26)},
      {"outlier", with_one(1e30)},
      {"saturated", saturated},
      {"nan", with_one(std::numeric_limits<double>::quiet_NaN())},
      {"infinity", with_one(kInfinity)},
      {"minus_infinity", with_one(-kInfinity)},
      {"gradient_tiny", one, one, fill::normal(1e-38)},
      {"gradient_huge", one, one, fill::normal(1e30)},
      {"gradient_nan", one, one, with_one(std::numeric_limits<double>::quiet_NaN())},
  };
  return regimes;
}

OpCase stressed(const OpCase& op_case, const Regime& regime) {
  OpCase result = op_case;
  result.name = op_case.name + "@" + regime.name;
  result.cotangent = regime.cotangent;
  for (size_t i = 0; i < result.inputs.size(); ++i) {
    InputSpec& input = result.inputs[i];
    if (i == 0 || input.name == "target") {
      input.fill = regime.first;
    } else if (input.differentiable) {
      input.fill = regime.others;
    }
  }
  return result;
}

}  // namespace opaline::check
