#include "train/interrupt.h"

namespace opaline {
namespace {

// A signal handler can reach nothing but static state.
volatile std::sig_atomic_t pending_signal = 0;

extern "C" void remember_signal(int signal) {
  pending_signal = signal;
}

}  // namespace

InterruptGuard::InterruptGuard() {
  pending_signal = 0;
  struct sigaction action {};
  action.sa_handler = remember_signal;
  // Back to the default after the first one, so that an impatient second signal ends the process. System
  // calls restart: a checkpoint in progress is not torn.
  action.sa_flags = static_cast<int>(SA_RESETHAND | SA_RESTART);
  sigemptyset(&action.sa_mask);
  sigaction(SIGINT, &action, &before_int_);
  sigaction(SIGTERM, &action, &before_term_);
}

InterruptGuard::~InterruptGuard() {
  sigaction(SIGINT, &before_int_, nullptr);
  sigaction(SIGTERM, &before_term_, nullptr);
}

int InterruptGuard::signal() const {
  return pending_signal;
}

}  // namespace opaline
