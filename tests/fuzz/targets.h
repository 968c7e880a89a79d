// The parsers of what comes from outside, as functions of bytes: what the mutation tests and the libFuzzer
// programs run. Any input must end in success or opaline::Error.
#pragma once

#include <cstddef>
#include <span>
#include <string_view>
#include <vector>

namespace opaline::fuzz {

using Bytes = std::vector<std::byte>;

struct Target {
  std::string_view name;
  /// Valid files, from which mutations start.
  std::vector<Bytes> (*seeds)();
  /// Parses; lets opaline::Error through.
  void (*parse)(std::span<const std::byte> bytes);
};

std::span<const Target> targets();

/// Parses and takes opaline::Error for an answer; anything else gets out.
void run(const Target& target, std::span<const std::byte> bytes);

}  // namespace opaline::fuzz
