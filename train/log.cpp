#include "train/log.h"

#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <cstring>
#include <ctime>
#include <string>

#include "core/error.h"
#include "core/file.h"

namespace opaline {
namespace {

/// Length of the first `lines` whole lines of the text, and how many there are.
std::pair<size_t, int64_t> whole_lines(std::string_view text, int64_t lines) {
  size_t end = 0;
  int64_t found = 0;
  while (found < lines) {
    const size_t next = text.find('\n', end);
    if (next == std::string_view::npos) break;
    end = next + 1;
    ++found;
  }
  return {end, found};
}

}  // namespace

std::string utc_now() {
  const std::time_t now = std::time(nullptr);
  std::tm parts{};
  ::gmtime_r(&now, &parts);
  std::array<char, 32> text{};
  std::strftime(text.data(), text.size(), "%Y-%m-%dT%H:%M:%SZ", &parts);
  return text.data();
}

std::string host_name() {
  std::array<char, 256> name{};
  return ::gethostname(name.data(), name.size() - 1) == 0 ? name.data() : "unknown";
}

void append_event(const std::filesystem::path& path, nlohmann::ordered_json event) {
  event["wall"]["time"] = utc_now();
  event["wall"]["host"] = host_name();
  const std::string line = event.dump() + "\n";
  const int file = ::open(path.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
  if (file < 0) fail(path.string(), "cannot open: {}", std::strerror(errno));
  // One write a line: an O_APPEND write of this size is not interleaved with another.
  const ssize_t written = ::write(file, line.data(), line.size());
  const int reason = errno;
  ::close(file);
  if (written != static_cast<ssize_t>(line.size())) {
    fail(path.string(), "cannot append an event of {} bytes: {}", line.size(),
         written < 0 ? std::strerror(reason) : "the disk is full");
  }
}

MetricsLog::MetricsLog(std::filesystem::path path, int64_t keep_lines) : path_(std::move(path)) {
  if (!std::filesystem::exists(path_)) return;
  const std::string text = read_text(path_);
  const auto [bytes, lines] = whole_lines(text, keep_lines);
  lines_ = lines;
  if (bytes != text.size()) write_file_atomically(path_, std::string_view(text).substr(0, bytes));
}

void MetricsLog::append(nlohmann::ordered_json event) {
  append_event(path_, std::move(event));
  ++lines_;
}

std::vector<nlohmann::json> read_events(const std::filesystem::path& path) {
  const std::string text = read_text(path);
  std::vector<nlohmann::json> events;
  size_t begin = 0;
  for (int64_t line = 1; begin < text.size(); ++line) {
    const size_t end = text.find('\n', begin);
    if (end == std::string::npos) break;  // unfinished: a run is writing, or was killed
    try {
      events.push_back(nlohmann::json::parse(text.begin() + static_cast<std::ptrdiff_t>(begin),
                                             text.begin() + static_cast<std::ptrdiff_t>(end)));
    } catch (const nlohmann::json::exception& error) {
      fail(path.string(), "line {} is not valid JSON: {}", line, error.what());
    }
    begin = end + 1;
  }
  return events;
}

}  // namespace opaline
