// An index file of our data set, train.jsonl or test.jsonl, too large to hold.
#pragma once

#include <cstdint>
#include <filesystem>
#include <vector>

#include "core/file.h"
#include "data/scene_set.h"

namespace opaline {

/// Eight bytes of memory a scene: where its line begins. Opening reads the file once, in pieces, and checks
/// every line; a record is read and parsed when asked for. Safe from several threads.
class SceneIndex {
 public:
  /// Throws Error naming file and line where a line is bad or an id comes twice.
  explicit SceneIndex(const std::filesystem::path& path);

  int64_t size() const { return static_cast<int64_t>(begin_.size()); }
  SceneRecord record(int64_t index) const;
  /// Of the file's bytes.
  uint64_t xxh64() const { return xxh64_; }

 private:
  std::filesystem::path path_;
  FileReader file_;
  std::vector<int64_t> begin_;
  uint64_t xxh64_ = 0;
};

}  // namespace opaline
