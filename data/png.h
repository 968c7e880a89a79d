// PNG files: strict reading of 8-bit images, writing of 8-bit RGB.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

namespace opaline {

struct PngImage {
  int width = 0;
  int height = 0;
  int channels = 0;               ///< 1 (grey) or 3 (RGB)
  int bits = 8;                   ///< depth of the file's samples: 8 or 16
  std::vector<uint16_t> samples;  ///< H x W x channels, 0 to 2^bits - 1

  size_t at(int x, int y, int channel) const {
    return (static_cast<size_t>(y) * static_cast<size_t>(width) + static_cast<size_t>(x)) *
               static_cast<size_t>(channels) +
           static_cast<size_t>(channel);
  }
};

/// Declared sizes over these are refused before anything of that size is allocated.
struct PngLimits {
  int max_side = 16384;
  int64_t max_pixels = int64_t{1} << 26;
};

/// Decodes a file in memory; `file` is for messages. 16-bit samples stay 16-bit, grey of 1, 2 and 4 bits is
/// widened to 8, a palette becomes RGB, an alpha channel is dropped where it is opaque throughout and is an
/// error elsewhere (what lies under a half-transparent pixel is not light that was measured). Empty,
/// truncated and damaged files are errors.
PngImage decode_png(std::span<const std::byte> bytes, const std::string& file, const PngLimits& limits = {});
PngImage read_png(const std::filesystem::path& path, const PngLimits& limits = {});

/// Width and height alone, from the first bytes of the file.
struct PngSize {
  int width = 0;
  int height = 0;
  bool operator==(const PngSize&) const = default;
};
PngSize read_png_size(const std::filesystem::path& path);

/// The bytes of an 8-bit file; channels is 1 or 3, pixels H x W x channels.
std::vector<std::byte> encode_png(int width, int height, int channels, std::span<const uint8_t> pixels);
/// encode_png, written under a temporary name and renamed.
void write_png(const std::filesystem::path& path, int width, int height, int channels,
               std::span<const uint8_t> pixels);

}  // namespace opaline
