#include "core/memory.h"

#include <sys/mman.h>

#include <algorithm>
#include <cstdlib>
#include <cstring>

#include "core/error.h"

namespace opaline {
namespace {

constexpr int64_t kAlignment = 64;
/// More than any address space holds; sizes below can be rounded up without overflow.
constexpr int64_t kImpossible = int64_t{1} << 56;

/// Sizes are rounded up to an eighth of their power of two, so that nearly equal requests share blocks while
/// at most an eighth is wasted.
int64_t bucket(int64_t bytes) {
  int64_t step = kAlignment;
  while (step * 16 <= bytes) step *= 2;
  return std::max(kAlignment, (bytes + step - 1) / step * step);
}

/// Memory from the system, or null. Large blocks ask for huge pages: transforms and gradients walk through
/// dozens of places at once, more than the translation cache holds of small pages.
std::byte* obtain(int64_t bytes) {
  constexpr int64_t kHugePage = int64_t{1} << 21;
  const bool huge = bytes >= 2 * kHugePage;
  const int64_t alignment = huge ? kHugePage : kAlignment;
  // Vectors without masks read up to one of them beyond the last element.
  const int64_t beyond = Pool::kReuses ? kAlignment : 0;
  const int64_t size = (bytes + beyond + alignment - 1) / alignment * alignment;
  void* const block = std::aligned_alloc(static_cast<size_t>(alignment), static_cast<size_t>(size));
  // A wish: where the system has no huge pages, small ones do.
  if (huge && block != nullptr) madvise(block, static_cast<size_t>(size), MADV_HUGEPAGE);
  return static_cast<std::byte*>(block);
}

}  // namespace

Pool::~Pool() {
  release_cached();
}

std::shared_ptr<std::byte> Pool::allocate(int64_t bytes) {
  if (bytes < 0) fail("pool", "cannot allocate {} bytes", bytes);
  if (bytes > kImpossible) fail("pool", "out of memory: {} bytes asked for", bytes);
  const int64_t size = bucket(bytes);
  std::byte* block = nullptr;
  {
    const std::lock_guard lock(mutex_);
    if (auto& kept = free_[size]; !kept.empty()) {
      block = kept.back();
      kept.pop_back();
    }
    in_use_ += size;
    peak_ = std::max(peak_, in_use_);
  }
  if (block == nullptr) {
    block = obtain(size);
    if (block == nullptr) {
      // Blocks of other sizes may be what is missing.
      release_cached();
      block = obtain(size);
    }
    if (block == nullptr) {
      const std::lock_guard lock(mutex_);
      in_use_ -= size;
      fail("pool", "out of memory: {} bytes asked for, {} in use; use a smaller micro_batch or image size",
           size, in_use_);
    }
  }
  if (!kReuses) std::memset(block, 0xFF, static_cast<size_t>(size));
  return {block, [this, size](std::byte* freed) {
            const std::lock_guard lock(mutex_);
            in_use_ -= size;
            if (kReuses) {
              free_[size].push_back(freed);
            } else {
              std::free(freed);
            }
          }};
}

int64_t Pool::bytes_in_use() const {
  const std::lock_guard lock(mutex_);
  return in_use_;
}

int64_t Pool::peak_bytes() const {
  const std::lock_guard lock(mutex_);
  return peak_;
}

void Pool::reset_peak() {
  const std::lock_guard lock(mutex_);
  peak_ = in_use_;
}

void Pool::release_cached() {
  const std::lock_guard lock(mutex_);
  for (auto& [size, blocks] : free_) {
    for (std::byte* block : blocks) std::free(block);
  }
  free_.clear();
}

Pool& tensor_pool() {
  // Never destroyed: tensors with static storage duration may outlive any order of destruction.
  static Pool& pool = *new Pool;
  return pool;
}

}  // namespace opaline
