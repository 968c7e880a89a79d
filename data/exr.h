// OpenEXR files as our data uses them: one or several scan-line parts by name, channels by name, half or
// float, any data window.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
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

/// Of the lossless ones; ZIP and PIZ pack 16 and 32 lines together, the others each line.
enum class ExrCompression { kNone, kRle, kZips, kZip, kPiz };

struct ExrImage {
  int width = 0;  ///< display window, from (0, 0)
  int height = 0;
  ExrCompression compression = ExrCompression::kZip;
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

/// The bytes of a file: scan lines, parts in the given order, one after the other.
std::vector<std::byte> encode_exr(const ExrImage& image);

/// Lines that are compressed together: the first of them, and where they are in the file.
struct ExrChunk {
  int y = 0;
  int64_t offset = 0;
};
/// The chunks of each part of a file that encode_exr made of `image`.
std::vector<std::vector<ExrChunk>> exr_chunks(std::span<const std::byte> bytes, const ExrImage& image);

/// encode_exr, written under a temporary name and renamed.
void write_exr(const std::filesystem::path& path, const ExrImage& image);

/// Lines [begin, end) of the image.
struct ExrRows {
  int begin = 0;
  int end = 0;
};

/// A piece of a file.
struct ExrBytes {
  int64_t offset = 0;
  std::span<const std::byte> bytes;
};

/// Reads parts of a file that is in memory. Headers are checked on construction, pixels decoded on demand: a
/// part that is not asked for costs nothing. Deep, tiled and subsampled parts, sizes over the limits and
/// damage are errors that name the file and the part.
class ExrReader {
 public:
  /// `bytes` must outlive the reader; `file` is for messages.
  ExrReader(std::span<const std::byte> bytes, std::string file, const ExrLimits& limits = {});
  /// Of a file of which only some pieces are in memory: the first with headers and line tables, others with
  /// the lines that will be asked for. Asking for what is not there is an error.
  ExrReader(std::span<const ExrBytes> pieces, int64_t file_bytes, std::string file,
            const ExrLimits& limits = {});
  ~ExrReader();
  ExrReader(const ExrReader&) = delete;
  ExrReader& operator=(const ExrReader&) = delete;

  int width() const;  ///< of the display window
  int height() const;
  const std::vector<ExrPartInfo>& parts() const;
  bool has_part(std::string_view name) const;

  /// The named channels of a part, in that order, as floats; of some rows only the window's part in them. A
  /// missing part or channel is an error that lists what there is.
  ExrPart read(std::string_view part, std::span<const std::string> channels,
               const std::optional<ExrRows>& rows = {}) const;
  /// All channels of a part, sorted by name.
  ExrPart read(std::string_view part) const;

 private:
  struct Impl;
  std::unique_ptr<Impl> impl_;
};

}  // namespace opaline
