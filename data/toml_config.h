// Strict reading of TOML configs. A getter names a key, its default and its range; every problem (a wrong
// type, a value out of range, a key that nobody asked for) is collected with file and line, and finish()
// throws them all at once.
//
//   TomlConfig config = TomlConfig::from_file("small.toml", {"train.epochs=3"});
//   TomlTable train = config.root().table("train");
//   options.epochs = train.integer("epochs", 20, {.min = 1});
//   config.finish();
#pragma once

#include <cstdint>
#include <filesystem>
#include <limits>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace opaline {

struct IntegerRange {
  int64_t min = std::numeric_limits<int64_t>::min();
  int64_t max = std::numeric_limits<int64_t>::max();
};

/// Inclusive; the defaults admit every finite number.
struct RealRange {
  double min = std::numeric_limits<double>::lowest();
  double max = std::numeric_limits<double>::max();
};

class TomlConfig;

/// One table of a config. A handle: copies look at the same config, which must outlive them.
class TomlTable {
 public:
  /// Each getter gives the key's value, or the default where the key is absent or wrong (and records why).
  int64_t integer(std::string_view key, int64_t otherwise, const IntegerRange& range = {}) const;
  /// Integers are taken too.
  double real(std::string_view key, double otherwise, const RealRange& range = {}) const;
  bool boolean(std::string_view key, bool otherwise) const;
  std::string text(std::string_view key, std::string_view otherwise) const;
  /// One of `choices`.
  std::string choice(std::string_view key, std::string_view otherwise,
                     std::span<const std::string_view> choices) const;
  std::vector<std::string> texts(std::string_view key, std::vector<std::string> otherwise) const;
  /// `count` numbers; 0 for any number of them.
  std::vector<double> reals(std::string_view key, std::vector<double> otherwise, const RealRange& range = {},
                            size_t count = 0) const;

  /// The sub-table of that name; an absent one reads as empty.
  TomlTable table(std::string_view key) const;
  bool has(std::string_view key) const;

  /// Records a problem of this key that a getter cannot see (such as one key contradicting another).
  void error(std::string_view key, std::string_view message) const;
  /// A missing key becomes a problem.
  void require(std::string_view key) const;

 private:
  friend class TomlConfig;
  TomlTable(TomlConfig* config, std::vector<std::string> path) : config_(config), path_(std::move(path)) {}

  TomlConfig* config_;
  std::vector<std::string> path_;
};

class TomlConfig {
 public:
  /// `overrides` are "table.key=value" with a TOML value (a bare word counts as a string); they win over the
  /// file. Throws UsageError where the file is missing or is not TOML.
  static TomlConfig from_file(const std::filesystem::path& path, std::span<const std::string> overrides = {});
  static TomlConfig from_text(std::string_view text, std::string_view name,
                              std::span<const std::string> overrides = {});
  ~TomlConfig();
  TomlConfig(TomlConfig&&) noexcept;
  TomlConfig& operator=(TomlConfig&&) noexcept;

  TomlTable root() { return {this, {}}; }
  /// Throws UsageError with every problem so far and every key that no getter asked for, each with file,
  /// line and, where one is near, the key that may have been meant.
  void finish() const;
  /// Every key that was asked for, with the value in force, as TOML: what a run folder keeps.
  std::string resolved() const;

 private:
  friend class TomlTable;
  struct State;
  explicit TomlConfig(std::unique_ptr<State> state);
  std::unique_ptr<State> state_;
};

/// The candidate nearest to `word` by edit distance; "" where none is near enough to have been meant.
std::string did_you_mean(std::string_view word, std::span<const std::string> candidates);

}  // namespace opaline
