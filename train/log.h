// RUN/metrics.jsonl: the record of a run, one JSON object a line.
//
// Every event has `event` ("run", "stage", "step", "epoch", "eval", "checkpoint", "end"). Whatever depends on
// the machine or the clock (time, host, rates) stands in the object `wall` and nowhere else: without it, the
// log of a run that was stopped and resumed is byte for byte that of one that never stopped.
#pragma once

#include <cstdint>
#include <filesystem>
#include <nlohmann/json.hpp>
#include <vector>

namespace opaline {

class MetricsLog {
 public:
  /// Goes on after the first `keep_lines` lines; what stands behind them is cut off (steps that a resumed run
  /// does again, or a line that a crash left unfinished). A shorter log is taken as it is.
  explicit MetricsLog(std::filesystem::path path, int64_t keep_lines = 0);

  /// Appends one line; `wall.time` and `wall.host` are added. Throws Error where it cannot be written.
  void append(nlohmann::ordered_json event);

  /// Lines in the file.
  int64_t lines() const { return lines_; }

 private:
  std::filesystem::path path_;
  int64_t lines_ = 0;
};

/// Appends one object as a line to a file, with `wall.time` and `wall.host`.
void append_event(const std::filesystem::path& path, nlohmann::ordered_json event);

/// All events of a log; a last line that is not whole is skipped. Throws Error naming file and line.
std::vector<nlohmann::json> read_events(const std::filesystem::path& path);

/// UTC, "2025-01-31T12:00:00Z".
std::string utc_now();
std::string host_name();

}  // namespace opaline
