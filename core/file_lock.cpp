#include "core/file_lock.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstring>
#include <string>
#include <system_error>

#include "core/error.h"

namespace opaline {

FileLock::FileLock(const std::filesystem::path& file, std::string_view what_it_does) {
  const std::filesystem::path folder = file.parent_path();
  std::error_code error;
  std::filesystem::create_directories(folder, error);
  if (error) fail(folder.string(), "cannot make the folder: {}", error.message());

  const std::string path = file.string();
  descriptor_ = ::open(path.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0644);
  if (descriptor_ < 0) fail(path, "cannot open the lock: {}", std::strerror(errno));
  if (::flock(descriptor_, LOCK_EX | LOCK_NB) != 0) {
    const int reason = errno;
    std::array<char, 64> owner{};
    const ssize_t got = ::read(descriptor_, owner.data(), owner.size());
    ::close(descriptor_);
    if (reason != EWOULDBLOCK) fail(path, "cannot lock: {}", std::strerror(reason));
    std::string_view text(owner.data(), got > 0 ? static_cast<size_t>(got) : 0);
    while (!text.empty() && text.back() == '\n') text.remove_suffix(1);
    fail(folder.string(), "process {} {}", text.empty() ? "(unknown)" : text, what_it_does);
  }
  // The process id is for people only, so a failed write costs nothing but a vaguer message.
  const std::string text = std::to_string(::getpid()) + "\n";
  if (::ftruncate(descriptor_, 0) == 0) {
    [[maybe_unused]] const ssize_t written = ::write(descriptor_, text.data(), text.size());
  }
}

FileLock::~FileLock() {
  ::close(descriptor_);
}

}  // namespace opaline
