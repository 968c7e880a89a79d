#include "core/numerics.h"

namespace opaline {
namespace {

Numerics& mode() {
  thread_local Numerics numerics = Numerics::kBalanced;
  return numerics;
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

Numerics current_numerics() {
  return mode();
}

NumericsGuard::NumericsGuard(Numerics numerics) : before_(mode()) {
  mode() = numerics;
}

NumericsGuard::~NumericsGuard() {
  mode() = before_;
}

}  // namespace opaline
