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

/// What is counted, and which units tell how long the rest will take.
struct ProgressPace {
  std::string_view items = "images";  ///< of the rate, a second; a literal
  /// True where units differ in cost but not in the long run (scenes): all of them count alike. False where
  /// the cost changes for good (another stage of training): the last twenty or so count.
  bool all_units = false;
};

/// Counts units (steps, scenes) of work whose total is known, weighs them by items (images) for the rate.
class Progress {
 public:
  explicit Progress(const ProgressOptions& options) : options_(options) {}
  ~Progress() { finish(); }
  Progress(const Progress&) = delete;
  Progress& operator=(const Progress&) = delete;

  /// Starts at `done` of `total` units; the rate counts from here.
  void start(int64_t done, int64_t total, const ProgressPace& pace = {});
  /// One unit of `items` items is done; `text` says what (stage, epoch, loss).
  void advance(int64_t items, std::string_view text);
  /// A line of its own, above the bar.
  void note(std::string_view line);
  /// Ends the bar's line.
  void finish();

  /// Items a second; 0 before the first.
  double rate() const;
  double seconds_left() const;

 private:
  using Clock = std::chrono::steady_clock;
  void print(std::string_view text, bool last);

  ProgressOptions options_;
  ProgressPace pace_;
  int64_t first_ = 0;  ///< units done at the start
  int64_t done_ = 0;
  int64_t total_ = 0;
  Clock::time_point last_unit_ = Clock::now();
  Clock::time_point last_line_ = {};
  double seconds_per_unit_ = 0.0;
  double items_per_unit_ = 0.0;
  bool line_open_ = false;
};

/// "42 s", "3 min 10 s", "2 h 5 min".
std::string format_duration(double seconds);

}  // namespace opaline
