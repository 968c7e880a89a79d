// The loop behind operations that map elements one by one. Internal to core/ops.
#pragma once

#include <vector>

#include "core/autograd.h"
#include "core/parallel.h"
#include "core/tensor.h"

namespace opaline {

inline constexpr int64_t kPointwiseBlock = 1 << 15;

/// y[i] = f(x[i]).
template <class T, class F>
void map(const Tensor& x, Tensor& y, const F& f) {
  const T* const from = x.data<T>();
  T* const to = y.data<T>();
  parallel_blocks(x.numel(), kPointwiseBlock, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) to[i] = f(from[i]);
  });
}

/// y[i] = f(a[i], b[i]).
template <class T, class F>
void map(const Tensor& a, const Tensor& b, Tensor& y, const F& f) {
  const T* const first = a.data<T>();
  const T* const second = b.data<T>();
  T* const to = y.data<T>();
  parallel_blocks(a.numel(), kPointwiseBlock, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) to[i] = f(first[i], second[i]);
  });
}

/// What the derivative of a pointwise operation is computed from.
enum class Saved { kInput, kOutput };

/// y = forward(x) elementwise with dx = backward(dy, saved), where saved is x or y. What saves x only is
/// recomputed where it is needed again.
template <class Forward, class Backward>
Tensor pointwise(std::string_view operation, const Tensor& x, Saved saved, Forward forward,
                 Backward backward) {
  const auto compute = [operation, forward](const Tensor& from) {
    Tensor to(from.shape(), from.dtype());
    dispatch_floating(operation, from.dtype(), [&]<class T>() { map<T>(from, to, forward); });
    return to.set_sites(from.sites());
  };
  const Tensor y = compute(x);
  if (!should_record({&x})) return y;
  const Tensor kept = saved == Saved::kInput ? x.saved() : y.detach();
  const auto gradient = [operation, kept, backward](const Tensor& dy, std::span<const char>) {
    Tensor dx(dy.shape(), dy.dtype());
    const Tensor values = kept.restored();
    dispatch_floating(operation, dy.dtype(), [&]<class T>() { map<T>(dy, values, dx, backward); });
    return std::vector<Tensor>{dx};
  };
  if (saved == Saved::kOutput) return record(operation, y, {x}, gradient);
  return record(operation, y, {x}, gradient, [kept, compute] { return compute(kept.restored()); });
}

}  // namespace opaline
