// Numbers for checks that C++ and scripts/parity/make_golden.py make alike: from an integer hash of a tag and
// the index.
#pragma once

#include <cstdint>
#include <string_view>

#include "core/tensor.h"
#include "nn/module.h"

namespace opaline::test {

inline constexpr uint64_t kInputTag = 1000;
inline constexpr uint64_t kCotangentTag = 1001;
inline constexpr uint64_t kProbeTag = 2000;  // and the two after it

/// In (-1, 1).
inline double pattern(uint64_t index, uint64_t tag) {
  uint64_t h = (index * 2654435761U + (tag + 1) * 2246822519U) & 0xFFFFFFFFU;
  h = ((h ^ (h >> 15)) * 2246822519U) & 0xFFFFFFFFU;
  h = ((h ^ (h >> 13)) * 3266489917U) & 0xFFFFFFFFU;
  h ^= h >> 16;
  return (static_cast<double>(h) + 0.5) / 2147483648.0 - 1.0;
}

/// offset + scale * pattern, in row-major order.
inline Tensor pattern_tensor(const Shape& shape, uint64_t tag, double scale = 1.0, double offset = 0.0,
                             DType dtype = DType::kFloat64) {
  Tensor result(shape, DType::kFloat64);
  uint64_t i = 0;
  for (double& value : result.values<double>()) value = offset + scale * pattern(i++, tag);
  return result.to(dtype);
}

/// Weights and buffers that are nowhere trivial.
inline void set_pattern_state(Module& module) {
  uint64_t tag = 0;
  for (NamedTensor& entry : module.named_state()) {
    const std::string_view name = entry.name;
    Tensor& tensor = entry.tensor;
    const auto set = [&](double scale, double offset) {
      tensor.copy_from(pattern_tensor(tensor.shape(), tag, scale, offset, tensor.dtype()));
    };
    if (name.ends_with("num_batches_tracked")) {
      tensor.fill(3.0);
    } else if (name.ends_with("running_mean")) {
      set(0.1, 0.0);
    } else if (name.ends_with("running_var")) {
      set(0.5, 1.0);
    } else if (tensor.dim() > 1) {
      set(0.14, 0.0);
    } else if (name.ends_with("weight")) {
      set(0.2, 1.0);
    } else {
      set(0.2, 0.0);
    }
    ++tag;
  }
}

}  // namespace opaline::test
