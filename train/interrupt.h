// SIGINT and SIGTERM as a wish to stop: the step in progress ends and its state is saved.
#pragma once

#include <csignal>

namespace opaline {

/// While it lives, the first SIGINT or SIGTERM is only remembered; a second one ends the process at once.
/// One at a time in a process.
class InterruptGuard {
 public:
  InterruptGuard();
  ~InterruptGuard();
  InterruptGuard(const InterruptGuard&) = delete;
  InterruptGuard& operator=(const InterruptGuard&) = delete;

  /// The signal that came, or 0.
  int signal() const;

 private:
  struct sigaction before_int_ {};
  struct sigaction before_term_ {};
};

}  // namespace opaline
