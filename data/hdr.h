// Radiance pictures (.hdr, RGBE), as panoramas come in.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

namespace opaline {

struct HdrImage {
  int width = 0;
  int height = 0;
  std::vector<float> pixels;  ///< H x W x 3, linear, row by row from the top
};

/// Declared sizes over these are refused before anything of that size is allocated.
struct HdrLimits {
  int max_side = 32768;
  int64_t max_pixels = int64_t{1} << 28;
};

/// Decodes a file in memory; `file` is for messages. Scan lines flat, or run-length coded in the old or the
/// new way; rows from the top, columns from the left (`-Y h +X w`). Other orders, XYZE and damage are errors.
/// The header's EXPOSURE is divided out.
HdrImage decode_hdr(std::span<const std::byte> bytes, const std::string& file, const HdrLimits& limits = {});
HdrImage read_hdr(const std::filesystem::path& path, const HdrLimits& limits = {});

}  // namespace opaline
