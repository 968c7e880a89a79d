#include "core/file.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>
#include <xxhash.h>

#include <cerrno>
#include <cstring>
#include <new>

#include "core/error.h"

namespace opaline {
namespace {

/// A file descriptor that closes itself.
class Descriptor {
 public:
  explicit Descriptor(int fd) : fd_(fd) {}
  Descriptor(const Descriptor&) = delete;
  Descriptor& operator=(const Descriptor&) = delete;
  ~Descriptor() {
    if (fd_ >= 0) ::close(fd_);
  }
  int get() const { return fd_; }
  /// Leaves closing to somebody else.
  void release() { fd_ = -1; }
  /// Closes now; false where the system reports a late write error.
  bool close() {
    const int fd = fd_;
    fd_ = -1;
    return ::close(fd) == 0;
  }

 private:
  int fd_;
};

void read_exactly(const std::filesystem::path& path, int fd, std::byte* to, int64_t bytes) {
  while (bytes > 0) {
    const ssize_t got = ::read(fd, to, static_cast<size_t>(bytes));
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) fail(path.string(), "cannot read: {}", std::strerror(errno));
    if (got == 0) fail(path.string(), "ended {} bytes early: did it change while it was read?", bytes);
    to += got;
    bytes -= got;
  }
}

/// Opens and measures; the size is checked before anything is allocated.
int64_t open_size(const std::filesystem::path& path, const Descriptor& file, int64_t max_bytes) {
  if (file.get() < 0) fail(path.string(), "cannot open: {}", std::strerror(errno));
  struct stat status {};
  if (::fstat(file.get(), &status) != 0) fail(path.string(), "cannot read: {}", std::strerror(errno));
  if (!S_ISREG(status.st_mode)) fail(path.string(), "is not a regular file");
  if (status.st_size > max_bytes) {
    fail(path.string(), "has {} bytes, more than the {} expected at most", status.st_size, max_bytes);
  }
  return status.st_size;
}

void sync_folder(const std::filesystem::path& folder) {
  const Descriptor descriptor(
      ::open(folder.empty() ? "." : folder.c_str(), O_RDONLY | O_DIRECTORY | O_CLOEXEC));
  // Not every file system lets a folder be synced; the rename itself has already happened.
  if (descriptor.get() >= 0) ::fsync(descriptor.get());
}

}  // namespace

std::vector<std::byte> read_file(const std::filesystem::path& path, int64_t max_bytes) {
  const Descriptor file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  std::vector<std::byte> bytes(static_cast<size_t>(open_size(path, file, max_bytes)));
  read_exactly(path, file.get(), bytes.data(), static_cast<int64_t>(bytes.size()));
  return bytes;
}

std::string read_text(const std::filesystem::path& path, int64_t max_bytes) {
  const Descriptor file(::open(path.c_str(), O_RDONLY | O_CLOEXEC));
  std::string text(static_cast<size_t>(open_size(path, file, max_bytes)), '\0');
  read_exactly(path, file.get(), reinterpret_cast<std::byte*>(text.data()),
               static_cast<int64_t>(text.size()));
  return text;
}

FileReader::FileReader(const std::filesystem::path& path, int64_t max_bytes)
    : path_(path), descriptor_(::open(path.c_str(), O_RDONLY | O_CLOEXEC)) {
  Descriptor file(descriptor_);
  size_ = open_size(path, file, max_bytes);
  file.release();
}

FileReader::~FileReader() {
  ::close(descriptor_);
}

void FileReader::read(int64_t offset, std::span<std::byte> to) const {
  while (!to.empty()) {
    const ssize_t got = ::pread(descriptor_, to.data(), to.size(), offset);
    if (got < 0 && errno == EINTR) continue;
    if (got < 0) fail(path_.string(), "cannot read: {}", std::strerror(errno));
    if (got == 0) fail(path_.string(), "ends at byte {}, {} more are needed", offset, to.size());
    to = to.subspan(static_cast<size_t>(got));
    offset += got;
  }
}

void write_file_atomically(const std::filesystem::path& path, std::span<const std::byte> bytes) {
  std::filesystem::path temporary = path;
  temporary += fmt::format(".tmp.{}", ::getpid());
  const auto give_up = [&](std::string_view what, int error) {
    ::unlink(temporary.c_str());
    fail(path.string(), "cannot {}: {}; what was there before is untouched", what, std::strerror(error));
  };
  Descriptor file(::open(temporary.c_str(), O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0644));
  if (file.get() < 0) fail(path.string(), "cannot create: {}", std::strerror(errno));
  while (!bytes.empty()) {
    const ssize_t written = ::write(file.get(), bytes.data(), bytes.size());
    if (written < 0 && errno == EINTR) continue;
    if (written < 0) give_up("write", errno);
    bytes = bytes.subspan(static_cast<size_t>(written));
  }
  if (::fsync(file.get()) != 0) give_up("sync", errno);
  if (!file.close()) give_up("close", errno);
  if (::rename(temporary.c_str(), path.c_str()) != 0) give_up("rename", errno);
  sync_folder(path.parent_path());
}

void write_file_atomically(const std::filesystem::path& path, std::string_view text) {
  write_file_atomically(path, std::as_bytes(std::span(text.data(), text.size())));
}

uint64_t xxh64(std::span<const std::byte> bytes) {
  return XXH64(bytes.data(), bytes.size(), 0);
}

Xxh64::Xxh64() : state_(XXH64_createState()) {
  if (state_ == nullptr) throw std::bad_alloc();
  XXH64_reset(static_cast<XXH64_state_t*>(state_), 0);
}

Xxh64::~Xxh64() {
  XXH64_freeState(static_cast<XXH64_state_t*>(state_));
}

void Xxh64::add(std::span<const std::byte> bytes) {
  XXH64_update(static_cast<XXH64_state_t*>(state_), bytes.data(), bytes.size());
}

uint64_t Xxh64::value() const {
  return XXH64_digest(static_cast<const XXH64_state_t*>(state_));
}

std::string to_hex(uint64_t value) {
  return fmt::format("{:016x}", value);
}

}  // namespace opaline
