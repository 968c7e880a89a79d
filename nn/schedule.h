// Factors on the learning rate: constant, then linearly down to (nearly) zero.
#pragma once

#include <algorithm>
#include <cstdint>

namespace opaline {

/// 1 - max(0, t - T/2) / (T/2) at step t of T, from 0: constant for the first half, then down to 2/T at the
/// last step.
inline double linear_decay_by_step(int64_t step, int64_t total_steps) {
  const double half = static_cast<double>(total_steps) / 2.0;
  const double past = std::max(0.0, static_cast<double>(step) - half);
  return half > 0.0 ? std::max(0.0, 1.0 - past / half) : 1.0;
}

/// 1 - max(0, e + 1 - constant) / (decay + 1) in epoch e, from 0. With the recipe's 10 and 10 this is
/// 1 - max(0, e - 9) / 11: the first lower rate comes in epoch 10, and the last epoch runs at 1/11.
inline double linear_decay_by_epoch(int64_t epoch, int64_t constant_epochs = 10, int64_t decay_epochs = 10) {
  const auto past = static_cast<double>(std::max<int64_t>(0, epoch + 1 - constant_epochs));
  return std::max(0.0, 1.0 - past / static_cast<double>(decay_epochs + 1));
}

}  // namespace opaline
