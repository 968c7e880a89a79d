// The line format of train.jsonl and test.jsonl.
#include <fcntl.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <cmath>
#include <cstring>
#include <nlohmann/json.hpp>
#include <span>
#include <utility>

#include "core/error.h"
#include "core/file.h"
#include "data/scene_index.h"

namespace opaline {
namespace {

using Json = nlohmann::ordered_json;

/// Typed access to the keys of one line; messages name line and key.
class Line {
 public:
  Line(const Json& json, std::string_view where) : json_(json), where_(where) {}

  const Json& at(const char* key) const {
    const auto found = json_.find(key);
    if (found == json_.end()) fail(where_, "key '{}' is missing", key);
    return *found;
  }
  std::string text(const char* key) const {
    const Json& value = at(key);
    if (!value.is_string()) fail(where_, "'{}' must be a string, not {}", key, value.dump());
    return value.get<std::string>();
  }
  double number(const char* key, double min, double max) const { return number(at(key), key, min, max); }
  template <class Integer>
  Integer integer(const char* key) const {
    const Json& value = at(key);
    const bool fits = value.is_number_unsigned() || (std::is_signed_v<Integer> && value.is_number_integer());
    if (!fits) fail(where_, "'{}' must be a whole number that is not negative, not {}", key, value.dump());
    return value.get<Integer>();
  }
  template <size_t N>
  std::array<double, N> numbers(const char* key, double min, double max) const {
    std::array<double, N> values{};
    fill(at(key), key, min, max, values);
    return values;
  }
  std::array<double, 27> sh() const {
    const Json& rows = at("sh");
    if (!rows.is_array() || rows.size() != 3) fail(where_, "'sh' must hold three rows of nine numbers");
    std::array<double, 27> values{};
    for (size_t c = 0; c < 3; ++c) {
      fill(rows[c], "sh", -1e6, 1e6, std::span<double>(values).subspan(9 * c, 9));
    }
    return values;
  }

 private:
  double number(const Json& value, const char* key, double min, double max) const {
    if (!value.is_number()) fail(where_, "'{}' must be a number, not {}", key, value.dump());
    const auto x = value.get<double>();
    if (!(x >= min && x <= max)) fail(where_, "'{}' is {}; it must be from {} to {}", key, x, min, max);
    return x;
  }
  void fill(const Json& from, const char* key, double min, double max, std::span<double> to) const {
    if (!from.is_array() || from.size() != to.size()) {
      fail(where_, "'{}' must hold {} numbers, not {}", key, to.size(), from.dump());
    }
    for (size_t i = 0; i < to.size(); ++i) to[i] = number(from[i], key, min, max);
  }

  const Json& json_;
  std::string_view where_;
};

Window parse_box(const Line& line, std::string_view where) {
  constexpr double kMaxSide = 1 << 24;
  const std::array<double, 4> box = line.numbers<4>("box", 0, kMaxSide);
  for (const double x : box) {
    if (x != std::floor(x)) fail(where, "'box' must hold whole numbers");
  }
  const Window window{static_cast<int>(box[0]), static_cast<int>(box[1]), static_cast<int>(box[2]),
                      static_cast<int>(box[3])};
  if (window.width() < 1 || window.height() < 1) fail(where, "'box' is empty: {}", to_string(window));
  return window;
}

std::array<FileSection, kSceneSections> parse_sections(const Json& json, std::string_view where) {
  std::array<FileSection, kSceneSections> sections;
  const auto is_section = [](const Json& s) {
    return s.is_array() && s.size() == 2 && s[0].is_number_unsigned() && s[1].is_string();
  };
  if (!json.is_array() || json.size() != kSceneSections ||
      !std::all_of(json.begin(), json.end(), is_section)) {
    fail(where, "'sections' must hold {} pairs of a size and a checksum, not {}", kSceneSections,
         json.dump());
  }
  constexpr uint64_t kMost = uint64_t{1} << 40;
  for (size_t i = 0; i < kSceneSections; ++i) {
    const auto bytes = json[i][0].get<uint64_t>();
    if (bytes > kMost) fail(where, "'sections' has one of {} bytes", bytes);
    sections[i] = {static_cast<int64_t>(bytes), json[i][1].get<std::string>()};
  }
  return sections;
}

/// A file of the set lies inside its folder: a line must not lead elsewhere.
void check_relative(const std::string& file, std::string_view where) {
  const std::filesystem::path path(file);
  bool inside = !file.empty() && path.is_relative();
  for (const std::filesystem::path& part : path) inside = inside && part != "..";
  if (!inside) fail(where, "'file' is '{}'; a path inside the data set is expected", file);
}

}  // namespace

std::string to_json_line(const SceneRecord& record) {
  Json sh = Json::array();
  for (size_t c = 0; c < 3; ++c) {
    sh.push_back(std::vector<double>(record.sh.begin() + static_cast<std::ptrdiff_t>(9 * c),
                                     record.sh.begin() + static_cast<std::ptrdiff_t>(9 * c + 9)));
  }
  Json json = {{"id", record.id},
               {"file", record.file},
               {"xxh64", record.xxh64},
               {"box", {record.box.x0, record.box.y0, record.box.x1, record.box.y1}},
               {"coverage", record.coverage},
               {"sigma_t", record.sigma_t},
               {"albedo", record.albedo},
               {"g", record.g},
               {"flash", record.flash},
               {"sh", sh},
               {"object", record.object},
               {"environment", record.environment},
               {"seed", record.seed},
               {"spp", record.spp},
               {"seconds", record.seconds}};
  if (record.sections) {
    Json sections = Json::array();
    for (const FileSection& section : *record.sections) sections.push_back({section.bytes, section.xxh64});
    json["sections"] = sections;
  }
  return json.dump();
}

SceneRecord parse_scene_record(std::string_view text, std::string_view where) {
  Json json;
  try {
    json = Json::parse(text);
  } catch (const Json::exception& e) {
    fail(where, "is not JSON: {}", e.what());
  }
  if (!json.is_object()) fail(where, "is not a JSON object");
  const Line line(json, where);
  constexpr double kLarge = 1e9;
  SceneRecord record;
  record.id = line.text("id");
  record.file = line.text("file");
  check_relative(record.file, where);
  record.xxh64 = line.text("xxh64");
  if (record.xxh64.size() != 16) fail(where, "'xxh64' is '{}'; 16 hexadecimal digits expected", record.xxh64);
  record.box = parse_box(line, where);
  record.coverage = line.number("coverage", 0, 1);
  record.sigma_t = line.numbers<3>("sigma_t", 0, kLarge);
  record.albedo = line.numbers<3>("albedo", 0, 1);
  record.g = line.number("g", -1, 1);
  record.flash = line.number("flash", 0, kLarge);
  record.sh = line.sh();
  record.object = line.text("object");
  record.environment = line.text("environment");
  record.seed = line.integer<uint64_t>("seed");
  record.spp = line.integer<int64_t>("spp");
  record.seconds = line.number("seconds", 0, kLarge);
  if (json.contains("sections")) record.sections = parse_sections(json["sections"], where);
  return record;
}

std::vector<SceneRecord> read_scene_index(const std::filesystem::path& path, bool salvage) {
  const std::string text = read_text(path);
  std::vector<SceneRecord> records;
  size_t number = 0;
  for (size_t begin = 0; begin < text.size();) {
    ++number;
    const size_t found = text.find('\n', begin);
    const bool torn = found == std::string::npos;
    if (torn && salvage) break;
    const size_t end = torn ? text.size() : found;
    const std::string_view line = std::string_view(text).substr(begin, end - begin);
    begin = end + 1;
    if (line.find_first_not_of(" \t\r") == std::string_view::npos) continue;
    try {
      records.push_back(parse_scene_record(line, fmt::format("{}:{}", path.string(), number)));
    } catch (const Error&) {
      if (!salvage) throw;
    }
  }
  return records;
}

void write_scene_index(const std::filesystem::path& path, const std::vector<SceneRecord>& records) {
  std::string text;
  for (const SceneRecord& record : records) text += to_json_line(record) + "\n";
  write_file_atomically(path, text);
}

void append_scene_record(const std::filesystem::path& path, const SceneRecord& record) {
  const std::string line = to_json_line(record) + "\n";
  const int file = ::open(path.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0644);
  if (file < 0) fail(path.string(), "cannot open: {}", std::strerror(errno));
  const off_t before = ::lseek(file, 0, SEEK_END);
  const ssize_t written = ::write(file, line.data(), line.size());
  int error = written < 0 ? errno : ENOSPC;
  bool whole = written == static_cast<ssize_t>(line.size());
  if (whole && ::fsync(file) != 0) {
    error = errno;
    whole = false;
  }
  // Half a line would join with the next one that somebody manages to write.
  if (!whole && before >= 0 && ::ftruncate(file, before) != 0) error = errno;
  ::close(file);
  if (!whole) fail(path.string(), "cannot add scene {}: {}", record.id, std::strerror(error));
}

SceneIndex::SceneIndex(const std::filesystem::path& path) : path_(path), file_(path) {
  constexpr size_t kPiece = size_t{1} << 20;
  constexpr size_t kLongestLine = kPiece;
  Xxh64 hash;
  std::vector<std::pair<uint64_t, int64_t>>
      ids;                 // hash and place: eight bytes each are enough to find doubles
  std::string text;        // what is not parsed yet
  int64_t text_begin = 0;  // its place in the file
  int64_t line_number = 0;
  const auto take_line = [&](std::string_view line) {
    ++line_number;
    if (line.find_first_not_of(" \t\r") != std::string_view::npos) {
      const SceneRecord record = parse_scene_record(line, fmt::format("{}:{}", path.string(), line_number));
      ids.emplace_back(opaline::xxh64(std::as_bytes(std::span(record.id))), size());
      begin_.push_back(text_begin);
    }
  };
  for (int64_t offset = 0; offset < file_.size();) {
    const auto piece = static_cast<size_t>(std::min<int64_t>(kPiece, file_.size() - offset));
    const size_t held = text.size();
    text.resize(held + piece);
    const std::span<std::byte> fresh = std::as_writable_bytes(std::span(text)).subspan(held);
    file_.read(offset, fresh);
    hash.add(fresh);
    offset += static_cast<int64_t>(piece);
    size_t begin = 0;
    for (size_t end = text.find('\n'); end != std::string::npos; end = text.find('\n', begin)) {
      take_line(std::string_view(text).substr(begin, end - begin));
      text_begin += static_cast<int64_t>(end + 1 - begin);
      begin = end + 1;
    }
    text.erase(0, begin);
    if (text.size() > kLongestLine) {
      fail(fmt::format("{}:{}", path.string(), line_number + 1), "has over {} characters", kLongestLine);
    }
  }
  take_line(text);
  begin_.shrink_to_fit();
  xxh64_ = hash.value();
  std::sort(ids.begin(), ids.end());
  for (size_t i = 1; i < ids.size(); ++i) {
    if (ids[i].first == ids[i - 1].first)
      fail(path.string(), "lists scene {} twice", record(ids[i].second).id);
  }
}

SceneRecord SceneIndex::record(int64_t index) const {
  const auto i = static_cast<size_t>(index);
  const int64_t end = i + 1 < begin_.size() ? begin_[i + 1] : file_.size();
  std::string line(static_cast<size_t>(end - begin_[i]), '\0');
  file_.read(begin_[i], std::as_writable_bytes(std::span(line)));
  line.resize(std::min(line.find('\n'), line.size()));
  return parse_scene_record(line, fmt::format("{}, scene {}", path_.string(), index));
}

}  // namespace opaline
