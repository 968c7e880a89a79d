// Ranges that parameters are drawn from.
#pragma once

#include <cmath>

#include "core/random.h"

namespace opaline::render {

struct Range {
  double low = 0;
  double high = 0;
};

inline double draw_uniform(const Range& range, Random& random) {
  return random.uniform(range.low, range.high);
}
/// Both ends positive.
inline double draw_log_uniform(const Range& range, Random& random) {
  return range.low * std::pow(range.high / range.low, random.uniform());
}

}  // namespace opaline::render
