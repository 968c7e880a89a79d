// OpenEXR files as our data uses them: one or several scan-line parts by name, channels by name, half or
// float, any data window.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "data/window.h"

namespace opaline {

/// One part: a window of the image, its channels interleaved.
struct ExrPart {
  std::string name = {};                   ///< "" in a file of one unnamed part
  Window window = {};                      ///< data window
  std::vector<std::string> channels = {};  ///< in the order in which `pixels` has them
  bool half = true;                        ///< stored as half floats (else as floats)
  std::vector<float> pixels = {};          ///< window height x window width x channels
};

struct ExrImage {
  int width = 0;  ///< display window, from (0, 0)
  int height = 0;
  std::vector<ExrPart> parts = {};
};

/// Declared sizes over these are refused before anything of that size is allocated.
struct ExrLimits {
  int max_side = 16384;
  int64_t max_values = int64_t{1} << 28;  ///< pixels x channels of one part
};

/// What a part declares.
struct ExrPartInfo {
  std::string name = {};
  Window window = {};
  std::vector<std::string> channels = {};  ///< sorted by name, as files have them
};

/// The bytes of a file: ZIP-compressed scan lines, parts in the given order.
std::vector<std::byte> encode_exr(const ExrImage& image);

/// encode_exr, written under a temporary name and renamed.
void write_exr(const std::filesystem::path& path, const ExrImage& image);

/// Reads parts of a file that is in memory. Headers are checked on construction, pixels decoded on demand: a
/// part that is not asked for costs nothing. Deep, tiled and subsampled parts, sizes over the limits and
/// damage are errors that name the file and the part.
class ExrReader {
 public:
  /// `bytes` must outlive the reader; `file` is for messages.
  ExrReader(std::span<const std::byte> bytes, std::string file, const ExrLimits& limits = {});
  ~ExrReader();
  ExrReader(const ExrReader&) = delete;
  ExrReader& operator=(const ExrReader&) = delete;

  int width() const;  ///< of the display window
  int height() const;
  const std::vector<ExrPartInfo>& parts() const;
  bool has_part(std::string_view name) const;

  /// The named channels of a part, in that order, as floats. A missing part or channel is an error that
  /// lists what there is.
  ExrPart read(std::string_view part, std::span<const std::string> channels) const;
  /// All channels of a part, sorted by name.
  ExrPart read(std::string_view part) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace opaline
