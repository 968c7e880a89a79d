#include "core/progress.h"

#include <fmt/format.h>
#include <unistd.h>

#include <algorithm>
#include <cmath>
#include <cstdio>

namespace opaline {
namespace {

constexpr int kBarWidth = 24;
// Smallest weight of the newest unit in the running means: about the last twenty count.
constexpr double kNewest = 0.05;

}  // namespace

ProgressOptions default_progress() {
  return {.terminal = ::isatty(STDERR_FILENO) == 1};
}

std::string format_duration(double seconds) {
  const auto whole = static_cast<int64_t>(std::llround(std::max(0.0, seconds)));
  if (whole < 60) return fmt::format("{} s", whole);
  if (whole < 3600) return fmt::format("{} min {} s", whole / 60, whole % 60);
  return fmt::format("{} h {} min", whole / 3600, whole % 3600 / 60);
}

void Progress::start(int64_t done, int64_t total, const ProgressPace& pace) {
  pace_ = pace;
  first_ = done_ = done;
  total_ = total;
  last_unit_ = Clock::now();
  seconds_per_unit_ = items_per_unit_ = 0.0;
}

double Progress::seconds_left() const {
  return seconds_per_unit_ * static_cast<double>(std::max<int64_t>(0, total_ - done_));
}

double Progress::rate() const {
  return seconds_per_unit_ > 0.0 ? items_per_unit_ / seconds_per_unit_ : 0.0;
}

void Progress::advance(int64_t items, std::string_view text) {
  const Clock::time_point now = Clock::now();
  const double seconds = std::max(1e-9, std::chrono::duration<double>(now - last_unit_).count());
  last_unit_ = now;
  ++done_;
  // A plain mean at first: units that end at the same time, on several threads, are no faster than others.
  const double equal = 1.0 / static_cast<double>(done_ - first_);
  const double weight = pace_.all_units ? equal : std::max(kNewest, equal);
  seconds_per_unit_ += weight * (seconds - seconds_per_unit_);
  items_per_unit_ += weight * (static_cast<double>(items) - items_per_unit_);
  print(text, done_ >= total_);
}

void Progress::print(std::string_view text, bool last) {
  if (options_.quiet) return;
  const Clock::time_point now = Clock::now();
  const double gap = options_.terminal ? 0.1 : options_.seconds_between_lines;
  if (!last && std::chrono::duration<double>(now - last_line_).count() < gap) return;
  last_line_ = now;
  const double part = total_ > 0 ? static_cast<double>(done_) / static_cast<double>(total_) : 1.0;
  const std::string tail = fmt::format("{}/{}  {}  {:.3g} {}/s  {} left", done_, total_, text, rate(),
                                       pace_.items, format_duration(seconds_left()));
  if (options_.terminal) {
    const auto filled = static_cast<size_t>(std::lround(part * kBarWidth));
    fmt::print(stderr, "\r\x1b[K[{}{}] {:3.0f} %  {}", std::string(filled, '='),
               std::string(kBarWidth - filled, ' '), 100.0 * part, tail);
    line_open_ = true;
  } else {
    fmt::print(stderr, "{:3.0f} %  {}\n", 100.0 * part, tail);
  }
  std::fflush(stderr);
}

void Progress::note(std::string_view line) {
  if (options_.quiet) return;
  finish();
  fmt::print(stderr, "{}\n", line);
  std::fflush(stderr);
}

void Progress::finish() {
  if (!line_open_) return;
  fmt::print(stderr, "\n");
  line_open_ = false;
}

}  // namespace opaline
