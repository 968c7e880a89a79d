// The storage pool: freed blocks are kept by size and handed out again, because a training step asks for the
// same sizes every time and fresh pages cost more than the arithmetic on them.
#pragma once

#include <cstddef>
#include <cstdint>
#include <map>
#include <memory>
#include <mutex>
#include <vector>

namespace opaline {

/// A caching allocator of 64-byte aligned blocks. Safe to use from several threads.
class Pool {
 public:
  /// Freed blocks are kept. Not where the address sanitizer watches: there every block is new to it and
  /// filled with NaN, for what a used block holds would hide an overrun, or a read of memory that nobody
  /// wrote.
#ifdef __SANITIZE_ADDRESS__
  static constexpr bool kReuses = false;
#else
  static constexpr bool kReuses = true;
#endif

  Pool() = default;
  Pool(const Pool&) = delete;
  Pool& operator=(const Pool&) = delete;
  ~Pool();

  /// A block of at least `bytes` bytes, uninitialised; it returns to the pool when the pointer dies.
  /// The pool must outlive it. Throws Error where memory does not suffice.
  std::shared_ptr<std::byte> allocate(int64_t bytes);

  /// Bytes in blocks that are in use now.
  int64_t bytes_in_use() const;
  /// Largest bytes_in_use() since the last reset_peak().
  int64_t peak_bytes() const;
  void reset_peak();
  /// Gives the kept blocks back to the system.
  void release_cached();

 private:
  mutable std::mutex mutex_;
  std::map<int64_t, std::vector<std::byte*>> free_;
  int64_t in_use_ = 0;
  int64_t peak_ = 0;
};

/// The pool that tensors allocate from.
Pool& tensor_pool();

}  // namespace opaline
