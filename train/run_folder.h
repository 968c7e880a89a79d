// A run folder: where its files are, and the lock that keeps a second process out.
#pragma once

#include <filesystem>

#include "core/file_lock.h"

namespace opaline {

/// RUN/config.toml       the resolved config
/// RUN/convolutions.json the algorithm of every convolution (core/kernels/conv_plan.h)
/// RUN/metrics.jsonl     the record of the run, one event a line (train/log.h)
/// RUN/sessions.jsonl    one line a process that trained here: host, command, where it began and why it ended
/// RUN/checkpoints/      step-N folders (train/checkpoint.h)
/// RUN/failures/         what replays a step whose loss was not finite
/// RUN/report.html       written by `opaline report`
struct RunFolder {
  std::filesystem::path root;

  std::filesystem::path config() const { return root / "config.toml"; }
  std::filesystem::path convolutions() const { return root / "convolutions.json"; }
  std::filesystem::path metrics() const { return root / "metrics.jsonl"; }
  std::filesystem::path sessions() const { return root / "sessions.jsonl"; }
  std::filesystem::path checkpoints() const { return root / "checkpoints"; }
  std::filesystem::path failures() const { return root / "failures"; }
  std::filesystem::path lock() const { return root / "lock"; }
  std::filesystem::path report() const { return root / "report.html"; }
};

/// Holds RUN/lock while it lives.
class RunLock {
 public:
  /// Makes the folder where there is none. Throws Error, naming the other process, where one holds the lock.
  explicit RunLock(const RunFolder& run);

 private:
  FileLock lock_;
};

}  // namespace opaline
