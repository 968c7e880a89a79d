// Progress on standard error: a bar on a terminal, plain lines elsewhere.
#pragma once

#include <chrono>
#include <cstdint>
#include <string>
#include <string_view>

namespace opaline {

struct ProgressOptions {
  bool quiet = false;
  bool terminal = false;             ///< draw a bar in place; otherwise lines
  double seconds_between_lines = 5;  ///< at most one line in this time
};

/// Options for this process: a bar where standard error is a terminal.
ProgressOptions default_progress();

/// Counts units (steps) of work whose total is known, weighs them by items (images) for the rate.
class Progress {
 public:
  explicit Progress(const ProgressOptions& options) : options_(options) {}
  ~Progress() { finish(); }
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  /// Starts at `done` of `total` units; the rate counts from here.
  void start(int64_t done, int64_t total);
  /// One unit of `items` items is done; `text` says what (stage, epoch, loss).
  void advance(int64_t items, std::string_view text);
  /// A line of its own, above the bar.
  void note(std::string_view line);
  /// Ends the bar's line.
  void finish();

  /// Items a second, over the last units; 0 before the first.
  double rate() const { return rate_; }
  double seconds_left() const;

 private:
  using Clock = std::chrono::steady_clock;
  void print(std::string_view text, bool last);

  ProgressOptions options_;
  int64_t done_ = 0;
  int64_t total_ = 0;
  Clock::time_point last_unit_ = Clock::now();
  Clock::time_point last_line_ = {};
  double seconds_per_unit_ = 0.0;
  double rate_ = 0.0;
  bool line_open_ = false;
};

/// "42 s", "3 min 10 s", "2 h 5 min".
std::string format_duration(double seconds);

}  // namespace opaline
