// Memory for the length of a call, from the tensor pool: a step asks for the same sizes every time.
#pragma once

#include <algorithm>
#include <cstdint>
#include <memory>

#include "core/memory.h"

namespace opaline::kernels {

/// `count` elements, uninitialised, 64-byte aligned.
template <class T>
class Scratch {
 public:
  explicit Scratch(int64_t count)
      : bytes_(tensor_pool().allocate(count * static_cast<int64_t>(sizeof(T)))), count_(count) {}
  T* data() const { return reinterpret_cast<T*>(bytes_.get()); }
  void zero() const { std::fill_n(data(), count_, T{}); }

 private:
  std::shared_ptr<std::byte> bytes_;
  int64_t count_;
};

}  // namespace opaline::kernels
