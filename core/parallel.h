// Threads. Work is cut into units by shape alone, never by the number of threads, so results are bitwise the
// same for any number of threads as long as a unit writes only what is its own.
#pragma once

#include <cstdint>
#include <exception>
#include <mutex>

namespace opaline {

/// Number of threads that parallel_for uses (OpenMP's setting for this thread).
int num_threads();

/// Sets it; 0 means all cores.
void set_num_threads(int threads);

/// Sets it for as long as it lives: for work so small that a team of threads costs more than it saves.
class ThreadsGuard {
 public:
  explicit ThreadsGuard(int threads) : before_(num_threads()) { set_num_threads(threads); }
  ~ThreadsGuard() { set_num_threads(before_); }
  ThreadsGuard(const ThreadsGuard&) = delete;
  ThreadsGuard& operator=(const ThreadsGuard&) = delete;

 private:
  int before_;
};

/// Calls f(i) for i in [0, n), each once, on any thread, in any order. Units are handed out dynamically.
/// The first exception thrown by a unit is rethrown here after all units have ended.
template <class F>
void parallel_for(int64_t n, const F& f) {
  if (n <= 0) return;
  if (n == 1 || num_threads() == 1) {
    for (int64_t i = 0; i < n; ++i) f(i);
    return;
  }
  std::exception_ptr error;
  std::mutex error_mutex;
#pragma omp parallel for schedule(dynamic, 1)
  for (int64_t i = 0; i < n; ++i) {
    try {
      f(i);
    } catch (...) {
      const std::lock_guard lock(error_mutex);
      if (!error) error = std::current_exception();
    }
  }
  if (error) std::rethrow_exception(error);
}

/// Calls f(begin, end) over [0, n) cut into blocks of `block` (the last may be shorter).
template <class F>
void parallel_blocks(int64_t n, int64_t block, const F& f) {
  const int64_t blocks = (n + block - 1) / block;
  parallel_for(blocks, [&](int64_t b) {
    const int64_t begin = b * block;
    const int64_t end = begin + block < n ? begin + block : n;
    f(begin, end);
  });
}

}  // namespace opaline
