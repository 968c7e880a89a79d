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

/// A file open for reading anywhere; safe from several threads. A file that is replaced meanwhile stays as it
/// was.
class FileReader {
 public:
  /// Throws as read_file does.
  explicit FileReader(const std::filesystem::path& path, int64_t max_bytes = int64_t{1} << 40);
  ~FileReader();
  FileReader(const FileReader&) = delete;
  FileReader& operator=(const FileReader&) = delete;

  int64_t size() const { return size_; }
  /// Fills `to` from `offset` on; an error that names the file where it ends before.
  void read(int64_t offset, std::span<std::byte> to) const;

 private:
  std::filesystem::path path_;
  int descriptor_;
  int64_t size_ = 0;
};

/// Writes `path.tmp.<pid>`, syncs it, renames it to `path`, syncs the folder. A failure leaves what was
/// there.
void write_file_atomically(const std::filesystem::path& path, std::span<const std::byte> bytes);
void write_file_atomically(const std::filesystem::path& path, std::string_view text);

/// XXH64 with seed 0.
uint64_t xxh64(std::span<const std::byte> bytes);
/// The same over pieces.
class Xxh64 {
 public:
  Xxh64();
  ~Xxh64();
  Xxh64(const Xxh64&) = delete;
  Xxh64& operator=(const Xxh64&) = delete;
  void add(std::span<const std::byte> bytes);
  uint64_t value() const;

 private:
  void* state_;
};
/// 16 lower-case hexadecimal digits.
std::string to_hex(uint64_t value);

}  // namespace opaline
