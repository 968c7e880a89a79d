// NumPy's .npy files, versions 1 to 3.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

namespace opaline {

struct NpyArray {
  std::vector<int64_t> shape;
  std::vector<double> values;  ///< row-major (C order), whatever the file's order
};

/// Decodes a file in memory; `file` is for messages. Floats of 16, 32 and 64 bits, integers of 8 to 64 bits
/// and booleans, of either byte order, in C or Fortran order. Other types (complex numbers, objects, text),
/// damage, and sizes over `max_values` are errors.
NpyArray decode_npy(std::span<const std::byte> bytes, const std::string& file,
                    int64_t max_values = int64_t{1} << 28);
NpyArray read_npy(const std::filesystem::path& path, int64_t max_values = int64_t{1} << 28);

/// A version 1.0 file of little-endian float32 in C order.
std::vector<std::byte> encode_npy(std::span<const float> values, std::span<const int64_t> shape);
void write_npy(const std::filesystem::path& path, std::span<const float> values,
               std::span<const int64_t> shape);

}  // namespace opaline
