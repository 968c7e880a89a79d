#include "core/numerics.h"

#include <utility>

#include "core/kernels/conv_plan.h"

namespace opaline {
namespace {

std::shared_ptr<kernels::ConvPlan>& plan_in_force() {
  thread_local auto plan = std::make_shared<kernels::ConvPlan>(Numerics::kBalanced);
  return plan;
}

}  // namespace

std::string_view to_string(Numerics numerics) {
  switch (numerics) {
    case Numerics::kStrict:
      return "strict";
    case Numerics::kBalanced:
      return "balanced";
    case Numerics::kFast:
      return "fast";
  }
  return "";
}

std::optional<Numerics> parse_numerics(std::string_view text) {
  for (const Numerics numerics : {Numerics::kStrict, Numerics::kBalanced, Numerics::kFast}) {
    if (text == to_string(numerics)) return numerics;
  }
  return std::nullopt;
}

std::shared_ptr<kernels::ConvPlan> current_conv_plan() {
  return plan_in_force();
}

Numerics current_numerics() {
  return plan_in_force()->numerics();
}

NumericsGuard::NumericsGuard(Numerics numerics)
    : NumericsGuard(std::make_shared<kernels::ConvPlan>(numerics)) {}

NumericsGuard::NumericsGuard(std::shared_ptr<kernels::ConvPlan> plan)
    : before_(std::exchange(plan_in_force(), std::move(plan))) {}

NumericsGuard::~NumericsGuard() {
  plan_in_force() = std::move(before_);
}

}  // namespace opaline
