// What a run will need of memory, told before its first step.
#pragma once

#include <cstdint>
#include <optional>
#include <string>

#include "train/config.h"

namespace opaline {

struct MemoryEstimate {
  int64_t parameters = 0;   ///< weights, gradients, moments and running statistics
  int64_t activations = 0;  ///< one micro-batch forward and backward, at its peak
  int64_t data = 0;         ///< batches read ahead, cached scenes

  int64_t total() const { return parameters + activations + data; }
};

/// Runs the largest stage that the config trains forward and backward on a few tiny images and scales what
/// the storage pool's peak grew by to a micro-batch of width x height images. Costs the memory of the
/// parameters, and the time of about two 128 x 128 images.
MemoryEstimate estimate_memory(const RunConfig& config, int64_t width, int64_t height);

/// Bytes that this process can still get: the system's available memory, or what is left under the control
/// group's limit where that is less. Absent where neither is told.
std::optional<int64_t> available_memory();

/// "stage 2 needs about 1.2 GiB: ..", with what to lower where it is more than `available`.
std::string describe(const MemoryEstimate& estimate, std::optional<int64_t> available);

}  // namespace opaline
