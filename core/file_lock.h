// A folder that one process at a time may write.
#pragma once

#include <filesystem>
#include <string_view>

namespace opaline {

/// Holds a lock file while it lives. The kernel drops the lock with the process, so a killed one leaves none;
/// the file itself stays and names its last owner.
class FileLock {
 public:
  /// Makes the file and its folder where there is none. Throws Error where another process holds the lock:
  /// "[folder] process 1234 <what it does>", as in "is training in this run folder; choose another --run".
  FileLock(const std::filesystem::path& file, std::string_view what_it_does);
  ~FileLock();
  FileLock(const FileLock&) = delete;
  FileLock& operator=(const FileLock&) = delete;

 private:
  int descriptor_ = -1;
};

}  // namespace opaline
