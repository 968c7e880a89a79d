// Errors: one exception type a meaning, so that the program maps them to exit codes in one place.
#pragma once

#include <fmt/format.h>

#include <stdexcept>
#include <string>
#include <string_view>
#include <utility>

namespace opaline {

/// A failed run: bad data, a failed write, diverged training. The program exits with 1.
class Error : public std::runtime_error {
 public:
  using std::runtime_error::runtime_error;
};

/// Bad usage or a bad config: the user has to change what was asked for. The program exits with 2.
class UsageError : public Error {
 public:
  using Error::Error;
};

/// Throws Error with the message "[where] ...". `where` is an operation or a file.
template <class... Args>
[[noreturn]] void fail(std::string_view where, fmt::format_string<Args...> format, Args&&... args) {
  throw Error(fmt::format("[{}] {}", where, fmt::format(format, std::forward<Args>(args)...)));
}

/// Throws UsageError with the message "[where] ...".
template <class... Args>
[[noreturn]] void fail_usage(std::string_view where, fmt::format_string<Args...> format, Args&&... args) {
  throw UsageError(fmt::format("[{}] {}", where, fmt::format(format, std::forward<Args>(args)...)));
}

}  // namespace opaline
