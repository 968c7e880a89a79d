// Clocks and counters for benchmarks.
#pragma once

#include <time.h>

#include <algorithm>
#include <chrono>
#include <cstdint>
#include <fstream>
#include <string>
#include <vector>

namespace opaline {

inline double read_clock(clockid_t clock) {
  timespec now{};
  ::clock_gettime(clock, &now);
  return static_cast<double>(now.tv_sec) + 1e-9 * static_cast<double>(now.tv_nsec);
}
/// Seconds that all threads of the process have computed: what a loaded machine changes little.
inline double process_cpu_seconds() {
  return read_clock(CLOCK_PROCESS_CPUTIME_ID);
}
inline double thread_cpu_seconds() {
  return read_clock(CLOCK_THREAD_CPUTIME_ID);
}
inline double wall_seconds() {
  return read_clock(CLOCK_MONOTONIC);
}

/// Bytes that the process has asked the system to read, cached or not; 0 where it does not tell.
inline int64_t bytes_read() {
  std::ifstream file("/proc/self/io");
  std::string key;
  int64_t value = 0;
  while (file >> key >> value) {
    if (key == "rchar:") return value;
  }
  return 0;
}

/// A field of /proc/self/status in bytes; 0 where the system does not tell.
inline int64_t status_bytes(const std::string& field) {
  std::ifstream file("/proc/self/status");
  std::string line;
  while (std::getline(file, line)) {
    if (line.starts_with(field + ":")) return 1024 * std::stoll(line.substr(field.size() + 1));
  }
  return 0;
}
/// Memory of the process that is in use now, and its largest since the last reset_resident_peak().
inline int64_t resident_bytes() {
  return status_bytes("VmRSS");
}
inline int64_t resident_peak_bytes() {
  return status_bytes("VmHWM");
}
/// False where the system has no such thing.
inline bool reset_resident_peak() {
  std::ofstream file("/proc/self/clear_refs");
  file << 5 << std::flush;
  return file.good();
}

inline double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

}  // namespace opaline
