// The choice between speed and rounding error. It admits algorithms; which of them runs is a function of
// shapes alone.
#pragma once

#include <optional>
#include <string_view>

namespace opaline {

/// Largest root-mean-square error of a convolution in float32 against float64, relative to the root mean
/// square of the result: strict 5e-7 (what direct sums have), balanced 3e-6, fast 3e-5.
enum class Numerics { kStrict, kBalanced, kFast };

/// "strict", "balanced" or "fast".
std::string_view to_string(Numerics numerics);
std::optional<Numerics> parse_numerics(std::string_view text);

/// What operations on this thread use: balanced, unless a guard says otherwise.
Numerics current_numerics();

/// Sets it for as long as it lives.
class NumericsGuard {
 public:
  explicit NumericsGuard(Numerics numerics);
  ~NumericsGuard();
  NumericsGuard(const NumericsGuard&) = delete;
  NumericsGuard& operator=(const NumericsGuard&) = delete;

 private:
  Numerics before_;
};

}  // namespace opaline
