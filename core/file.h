// Files that are either whole or absent.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace opaline {

/// The whole file. Throws Error naming the file; over `max_bytes` is an error before allocation.
std::vector<std::byte> read_file(const std::filesystem::path& path, int64_t max_bytes = int64_t{1} << 34);
std::string read_text(const std::filesystem::path& path, int64_t max_bytes = int64_t{1} << 30);

/// Writes `path.tmp.<pid>`, syncs it, renames it to `path`, syncs the folder. A failure leaves what was
/// there.
void write_file_atomically(const std::filesystem::path& path, std::span<const std::byte> bytes);
void write_file_atomically(const std::filesystem::path& path, std::string_view text);

/// XXH64 with seed 0.
uint64_t xxh64(std::span<const std::byte> bytes);
/// 16 lower-case hexadecimal digits.
std::string to_hex(uint64_t value);

}  // namespace opaline
