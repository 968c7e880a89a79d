#include "core/file.h"

#include <sys/resource.h>
#include <unistd.h>

#include <catch2/catch.hpp>
#include <csignal>
#include <filesystem>
#include <fstream>
#include <span>
#include <string>

#include "core/error.h"
#include "tests/core/support.h"

namespace opaline {
namespace {

namespace fs = std::filesystem;
using test::TemporaryFolder;

size_t entries(const fs::path& folder) {
  return static_cast<size_t>(std::distance(fs::directory_iterator(folder), fs::directory_iterator()));
}

TEST_CASE("what is written is read back") {
  const TemporaryFolder folder;
  const std::string text("a\0b\n", 4);
  write_file_atomically(folder / "file", text);
  CHECK(read_text(folder / "file") == text);
  CHECK(read_file(folder / "file").size() == 4);
  write_file_atomically(folder / "file", std::string_view());
  CHECK(read_text(folder / "file").empty());
  CHECK(entries(folder.path()) == 1);  // no temporary file stays
}

TEST_CASE("a file is read anywhere, and hashed in pieces") {
  const TemporaryFolder folder;
  const std::string text = "0123456789";
  write_file_atomically(folder / "file", text);
  const FileReader file(folder / "file");
  CHECK(file.size() == 10);
  std::string part(4, ' ');
  file.read(3, std::as_writable_bytes(std::span(part)));
  CHECK(part == "3456");
  const std::string name = (folder / "file").string();
  CHECK_THROWS_WITH(file.read(8, std::as_writable_bytes(std::span(part))), Catch::Contains(name));
  CHECK_THROWS_WITH(FileReader(folder / "missing"), Catch::Contains("No such file"));
  CHECK_THROWS_WITH(FileReader(folder.path()), Catch::Contains("not a regular file"));
  CHECK_THROWS_WITH(FileReader(folder / "file", 9), Catch::Contains("10"));
  write_file_atomically(folder / "file", std::string("new"));
  file.read(6, std::as_writable_bytes(std::span(part)));
  CHECK(part == "6789");  // what was open stays

  const auto bytes = std::as_bytes(std::span(text));
  Xxh64 hash;
  CHECK(hash.value() == xxh64({}));
  hash.add(bytes.first(3));
  hash.add(bytes.subspan(3));
  CHECK(hash.value() == xxh64(bytes));
}

TEST_CASE("files that cannot be read are named") {
  const TemporaryFolder folder;
  const std::string missing = (folder / "missing").string();
  CHECK_THROWS_WITH(read_file(missing), Catch::Contains(missing) && Catch::Contains("No such file"));
  CHECK_THROWS_WITH(read_text(folder.path()), Catch::Contains("not a regular file"));
  write_file_atomically(folder / "big", std::string(1000, 'x'));
  CHECK_THROWS_WITH(read_text(folder / "big", 999), Catch::Contains("1000") && Catch::Contains("999"));
  CHECK(read_text(folder / "big", 1000).size() == 1000);
  // A sparse file of a terabyte costs nothing but would cost a terabyte to read.
  std::ofstream(folder / "sparse") << 'x';
  fs::resize_file(folder / "sparse", uintmax_t{1} << 40);
  CHECK_THROWS_WITH(read_file(folder / "sparse"), Catch::Contains("1099511627776"));
}

TEST_CASE("a write that cannot begin leaves what was there") {
  const TemporaryFolder folder;
  CHECK_THROWS_WITH(write_file_atomically(folder / "none/file", "new"),
                    Catch::Contains("none/file") && Catch::Contains("cannot create"));
  fs::create_directory(folder / "target");
  write_file_atomically(folder / "target/inside", "kept");
  CHECK_THROWS_WITH(write_file_atomically(folder / "target", "new"), Catch::Contains("cannot rename"));
  CHECK(read_text(folder / "target/inside") == "kept");
  CHECK(entries(folder.path()) == 1);
}

TEST_CASE("a write that stops half way leaves what was there and no rest") {
  const TemporaryFolder folder;
  write_file_atomically(folder / "file", "old");
  // A limit on the size of files acts as a full disk.
  rlimit before{};
  REQUIRE(::getrlimit(RLIMIT_FSIZE, &before) == 0);
  const auto old_handler = std::signal(SIGXFSZ, SIG_IGN);
  rlimit small = before;
  small.rlim_cur = 4096;
  REQUIRE(::setrlimit(RLIMIT_FSIZE, &small) == 0);
  std::string message;
  try {
    write_file_atomically(folder / "file", std::string(100'000, 'x'));
  } catch (const Error& error) {
    message = error.what();
  }
  REQUIRE(::setrlimit(RLIMIT_FSIZE, &before) == 0);
  std::signal(SIGXFSZ, old_handler);
  CHECK_THAT(message, Catch::Contains("cannot write") && Catch::Contains("untouched"));
  CHECK(read_text(folder / "file") == "old");
  CHECK(entries(folder.path()) == 1);
}

TEST_CASE("checksums are XXH64's") {
  CHECK(to_hex(xxh64({})) == "ef46db3751d8e999");
  const std::string text = "abc";
  CHECK(to_hex(xxh64(std::as_bytes(std::span(text.data(), text.size())))) == "44bc2cf5ad770999");
  CHECK(to_hex(1) == "0000000000000001");
}

}  // namespace
}  // namespace opaline
