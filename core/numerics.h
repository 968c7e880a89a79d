// The choice between speed and rounding error. It admits algorithms; which of them runs is a function of
// shapes alone.
#pragma once

#include <memory>
#include <optional>
#include <string_view>

namespace opaline {

namespace kernels {
class ConvPlan;  // core/kernels/conv_plan.h
}

/// Largest root-mean-square error of a convolution in float32 against float64, relative to the root mean
/// square of the result: strict 5e-7 (what direct sums have), balanced 3e-6, fast 3e-5.
enum class Numerics { kStrict, kBalanced, kFast };

/// "strict", "balanced" or "fast".
std::string_view to_string(Numerics numerics);
std::optional<Numerics> parse_numerics(std::string_view text);

/// What convolutions on this thread go by: balanced, unless a guard says otherwise.
std::shared_ptr<kernels::ConvPlan> current_conv_plan();
Numerics current_numerics();

/// Sets it for as long as it lives.
class NumericsGuard {
 public:
  explicit NumericsGuard(Numerics numerics);
  explicit NumericsGuard(std::shared_ptr<kernels::ConvPlan> plan);
  ~NumericsGuard();
  NumericsGuard(const NumericsGuard&) = delete;
  NumericsGuard& operator=(const NumericsGuard&) = delete;

 private:
  std::shared_ptr<kernels::ConvPlan> before_;
};

}  // namespace opaline
