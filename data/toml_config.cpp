#include "data/toml_config.h"

#include <toml++/toml.h>
#include <algorithm>
#include <cctype>
#include <map>
#include <set>
#include <sstream>

#include "core/error.h"
#include "core/file.h"

namespace opaline {
namespace {

using Path = std::vector<std::string>;

/// Problems in the order of the file, the override ones last.
struct Problem {
  uint32_t line = 0;
  std::string message;
};

std::string dotted(const Path& path, std::string_view key = {}) {
  std::string text = fmt::format("{}", fmt::join(path, "."));
  if (key.empty()) return text;
  if (!text.empty()) text += '.';
  return text.append(key);
}

/// Levenshtein distance, a swap of neighbours counting as one.
size_t edit_distance(std::string_view a, std::string_view b) {
  std::vector<std::vector<size_t>> d(a.size() + 1, std::vector<size_t>(b.size() + 1));
  for (size_t i = 0; i <= a.size(); ++i) {
    for (size_t j = 0; j <= b.size(); ++j) {
      if (i == 0 || j == 0) {
        d[i][j] = i + j;
        continue;
      }
      const size_t change = a[i - 1] == b[j - 1] ? 0 : 1;
      d[i][j] = std::min({d[i - 1][j] + 1, d[i][j - 1] + 1, d[i - 1][j - 1] + change});
      if (i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1]) {
        d[i][j] = std::min(d[i][j], d[i - 2][j - 2] + 1);
      }
    }
  }
  return d[a.size()][b.size()];
}

std::string_view kind_of(const toml::node& node) {
  switch (node.type()) {
    case toml::node_type::table:
      return "a table";
    case toml::node_type::array:
      return "an array";
    case toml::node_type::string:
      return "a string";
    case toml::node_type::integer:
      return "an integer";
    case toml::node_type::floating_point:
      return "a number";
    case toml::node_type::boolean:
      return "true or false";
    default:
      return "a date or time";
  }
}

/// Merges `from` into `to`; values of `from` win, tables are joined.
void merge(toml::table& to, const toml::table& from) {
  for (const auto& entry : from) {
    const toml::key& key = entry.first;  // names, not bindings: a lambda below captures one
    const toml::node& node = entry.second;
    toml::node* existing = to.get(key.str());
    if (existing != nullptr && existing->is_table() && node.is_table()) {
      merge(*existing->as_table(), *node.as_table());
    } else {
      node.visit([&](const auto& value) { to.insert_or_assign(key.str(), value); });
    }
  }
}

/// "a.b=value" as a table. A value that is not TOML counts as a string, so that names need no quotes.
toml::table parse_override(const std::string& text) {
  const std::string source = "--set " + text;
  const size_t equals = text.find('=');
  if (equals == std::string::npos || equals == 0) {
    fail_usage(source, "is not of the form key=value (such as train.epochs=3)");
  }
  const std::string key = text.substr(0, equals);
  const std::string value = text.substr(equals + 1);
  try {
    return toml::parse(key + " = " + value, source);
  } catch (const toml::parse_error&) {
  }
  std::string quoted;
  for (const char c : value) {
    if (c == '"' || c == '\\') quoted += '\\';
    quoted += c;
  }
  try {
    return toml::parse(key + " = \"" + quoted + "\"", source);
  } catch (const toml::parse_error& e) {
    fail_usage(source, "cannot be understood: {}", e.description());
  }
}

std::string without_space(std::string text) {
  std::erase_if(text, [](char c) { return c == ' ' || c == '\t'; });
  return text;
}

template <class T>
std::string range_text(T low, T high, T none_low, T none_high) {
  if (low == none_low && high == none_high) return "finite";
  if (low == none_low) return fmt::format("at most {}", high);
  if (high == none_high) return fmt::format("at least {}", low);
  return fmt::format("between {} and {}", low, high);
}

}  // namespace

struct TomlConfig::State {
  std::string name;
  toml::table values;
  toml::table resolved;
  std::map<Path, std::set<std::string, std::less<>>> asked;    // keys by table
  std::vector<std::pair<std::string, std::string>> overrides;  // key and whole text of each --set, last first
  std::vector<Problem> problems;

  const toml::table* find(const Path& path) const {
    const toml::table* table = &values;
    for (const std::string& part : path) {
      const toml::node* node = table->get(part);
      table = node == nullptr ? nullptr : node->as_table();
      if (table == nullptr) return nullptr;
    }
    return table;
  }

  /// The node of a key, which from now on is known.
  const toml::node* ask(const Path& path, std::string_view key) {
    asked[path].insert(std::string(key));
    const toml::table* table = find(path);
    return table == nullptr ? nullptr : table->get(key);
  }

  /// The node of a key without making the key known.
  const toml::node* peek(const Path& path, std::string_view key) const {
    const toml::table* table = find(path);
    return table == nullptr ? nullptr : table->get(key);
  }

  /// Where a key stands: its line, or the override that set it.
  Problem place(const Path& path, std::string_view key, const toml::node* node,
                std::string_view message) const {
    const std::string full = dotted(path, key);
    for (const auto& [set_key, text] : overrides) {
      const bool inside =
          full.starts_with(set_key) && (full.size() == set_key.size() || full[set_key.size()] == '.');
      if (inside) return {UINT32_MAX, fmt::format("--set {}: {}", text, message)};
    }
    if (node == nullptr) return {0, fmt::format("{}: {}", name, message)};
    const auto line = static_cast<uint32_t>(node->source().begin.line);
    return {line, fmt::format("{}:{}: {}", name, line, message)};
  }

  void problem(const Path& path, std::string_view key, const toml::node* node, std::string_view message) {
    problems.push_back(place(path, key, node, message));
  }

  template <class T>
  void resolve(const Path& path, std::string_view key, T&& value) {
    toml::table* table = &resolved;
    for (const std::string& part : path) {
      table = table->insert(part, toml::table{}).first->second.as_table();
    }
    table->insert_or_assign(key, std::forward<T>(value));
  }

  void find_unknown(const toml::table& table, Path& path, std::vector<Problem>& found) const {
    const auto known = asked.find(path);
    for (const auto& [key, node] : table) {
      const std::string word(key.str());
      if (known != asked.end() && known->second.contains(word)) {
        path.push_back(word);
        if (node.is_table() && asked.contains(path)) find_unknown(*node.as_table(), path, found);
        path.pop_back();
        continue;
      }
      std::vector<std::string> candidates;
      if (known != asked.end()) candidates.assign(known->second.begin(), known->second.end());
      const std::string near = did_you_mean(word, candidates);
      std::string message = fmt::format("unknown key '{}'", dotted(path, word));
      if (!near.empty()) {
        message += fmt::format("; did you mean '{}'?", dotted(path, near));
      } else if (!candidates.empty()) {
        message += fmt::format("; known here: {}", fmt::join(candidates, ", "));
      }
      found.push_back(place(path, word, &node, message));
    }
  }
};

TomlConfig::TomlConfig(std::unique_ptr<State> state) : state_(std::move(state)) {}
TomlConfig::~TomlConfig() = default;
TomlConfig::TomlConfig(TomlConfig&&) noexcept = default;
TomlConfig& TomlConfig::operator=(TomlConfig&&) noexcept = default;

TomlConfig TomlConfig::from_file(const std::filesystem::path& path, std::span<const std::string> overrides) {
  constexpr int64_t kMaxBytes = int64_t{16} << 20;
  std::string text;
  try {
    text = read_text(path, kMaxBytes);
  } catch (const Error& e) {
    throw UsageError(e.what());
  }
  return from_text(text, path.string(), overrides);
}

TomlConfig TomlConfig::from_text(std::string_view text, std::string_view name,
                                 std::span<const std::string> overrides) {
  auto state = std::make_unique<State>();
  state->name = std::string(name);
  try {
    state->values = toml::parse(text, name);
  } catch (const toml::parse_error& e) {
    throw UsageError(fmt::format("{}:{}: {}", name, e.source().begin.line, e.description()));
  }
  for (const std::string& one : overrides) {
    merge(state->values, parse_override(one));  // merging copies nodes, which forget where they came from
    state->overrides.insert(state->overrides.begin(), {without_space(one.substr(0, one.find('='))), one});
  }
  return TomlConfig(std::move(state));
}

void TomlConfig::finish() const {
  std::vector<Problem> problems = state_->problems;
  Path path;
  state_->find_unknown(state_->values, path, problems);
  if (problems.empty()) return;
  std::stable_sort(problems.begin(), problems.end(),
                   [](const Problem& a, const Problem& b) { return a.line < b.line; });
  std::string message;
  for (const Problem& problem : problems) {
    if (!message.empty()) message += '\n';
    message += problem.message;
  }
  throw UsageError(message);
}

std::string TomlConfig::resolved() const {
  std::ostringstream out;
  out << state_->resolved << '\n';
  return out.str();
}

int64_t TomlTable::integer(std::string_view key, int64_t otherwise, const IntegerRange& range) const {
  TomlConfig::State& state = *config_->state_;
  int64_t result = otherwise;
  if (const toml::node* node = state.ask(path_, key)) {
    const auto* value = node->as_integer();
    if (value == nullptr) {
      state.problem(path_, key, node,
                    fmt::format("'{}' must be an integer, not {}", dotted(path_, key), kind_of(*node)));
    } else if (value->get() < range.min || value->get() > range.max) {
      const IntegerRange open;
      state.problem(path_, key, node,
                    fmt::format("'{}' is {}; it must be {}", dotted(path_, key), value->get(),
                                range_text(range.min, range.max, open.min, open.max)));
    } else {
      result = value->get();
    }
  }
  state.resolve(path_, key, result);
  return result;
}

double TomlTable::real(std::string_view key, double otherwise, const RealRange& range) const {
  TomlConfig::State& state = *config_->state_;
  double result = otherwise;
  if (const toml::node* node = state.ask(path_, key)) {
    const auto value = node->value<double>();
    if (!node->is_number() || !value) {
      state.problem(path_, key, node,
                    fmt::format("'{}' must be a number, not {}", dotted(path_, key), kind_of(*node)));
    } else if (!(*value >= range.min && *value <= range.max)) {
      const RealRange open;
      state.problem(path_, key, node,
                    fmt::format("'{}' is {}; it must be {}", dotted(path_, key), *value,
                                range_text(range.min, range.max, open.min, open.max)));
    } else {
      result = *value;
    }
  }
  state.resolve(path_, key, result);
  return result;
}

bool TomlTable::boolean(std::string_view key, bool otherwise) const {
  TomlConfig::State& state = *config_->state_;
  bool result = otherwise;
  if (const toml::node* node = state.ask(path_, key)) {
    if (const auto* value = node->as_boolean()) {
      result = value->get();
    } else {
      state.problem(path_, key, node,
                    fmt::format("'{}' must be true or false, not {}", dotted(path_, key), kind_of(*node)));
    }
  }
  state.resolve(path_, key, result);
  return result;
}

std::string TomlTable::text(std::string_view key, std::string_view otherwise) const {
  TomlConfig::State& state = *config_->state_;
  std::string result(otherwise);
  if (const toml::node* node = state.ask(path_, key)) {
    if (const auto* value = node->as_string()) {
      result = value->get();
    } else {
      state.problem(path_, key, node,
                    fmt::format("'{}' must be a string, not {}", dotted(path_, key), kind_of(*node)));
    }
  }
  state.resolve(path_, key, result);
  return result;
}

std::string TomlTable::choice(std::string_view key, std::string_view otherwise,
                              std::span<const std::string_view> choices) const {
  const std::string value = text(key, otherwise);
  if (value == otherwise || std::find(choices.begin(), choices.end(), value) != choices.end()) return value;
  const std::vector<std::string> candidates(choices.begin(), choices.end());
  const std::string near = did_you_mean(value, candidates);
  error(key, fmt::format("'{}' is not one of: {}{}", value, fmt::join(choices, ", "),
                         near.empty() ? std::string() : fmt::format("; did you mean '{}'?", near)));
  config_->state_->resolve(path_, key, std::string(otherwise));
  return std::string(otherwise);
}

std::vector<std::string> TomlTable::texts(std::string_view key, std::vector<std::string> otherwise) const {
  TomlConfig::State& state = *config_->state_;
  std::vector<std::string> result = std::move(otherwise);
  if (const toml::node* node = state.ask(path_, key)) {
    const auto* array = node->as_array();
    if (array == nullptr) {
      state.problem(
          path_, key, node,
          fmt::format("'{}' must be an array of strings, not {}", dotted(path_, key), kind_of(*node)));
    } else {
      std::vector<std::string> read;
      for (const toml::node& item : *array) {
        if (const auto* value = item.as_string()) {
          read.push_back(value->get());
        } else {
          state.problem(path_, key, &item,
                        fmt::format("'{}' must hold strings, not {}", dotted(path_, key), kind_of(item)));
        }
      }
      result = std::move(read);
    }
  }
  toml::array array;
  for (const std::string& value : result) array.push_back(value);
  state.resolve(path_, key, std::move(array));
  return result;
}

std::vector<double> TomlTable::reals(std::string_view key, std::vector<double> otherwise,
                                     const RealRange& range, size_t count) const {
  TomlConfig::State& state = *config_->state_;
  std::vector<double> result = std::move(otherwise);
  if (const toml::node* node = state.ask(path_, key)) {
    const auto* array = node->as_array();
    if (array == nullptr || (count != 0 && array->size() != count)) {
      const std::string wanted = count == 0 ? "an array of numbers" : fmt::format("{} numbers", count);
      state.problem(
          path_, key, node,
          fmt::format("'{}' must be {}, not {}", dotted(path_, key), wanted,
                      array == nullptr ? std::string(kind_of(*node)) : fmt::format("{}", array->size())));
    } else {
      std::vector<double> read;
      for (const toml::node& item : *array) {
        const auto value = item.value<double>();
        if (item.is_number() && value && *value >= range.min && *value <= range.max) {
          read.push_back(*value);
          continue;
        }
        const RealRange open;
        state.problem(path_, key, &item,
                      fmt::format("'{}' must hold numbers {}", dotted(path_, key),
                                  range_text(range.min, range.max, open.min, open.max)));
      }
      if (read.size() == array->size()) result = std::move(read);
    }
  }
  toml::array array;
  for (const double value : result) array.push_back(value);
  state.resolve(path_, key, std::move(array));
  return result;
}

TomlTable TomlTable::table(std::string_view key) const {
  TomlConfig::State& state = *config_->state_;
  const toml::node* node = state.ask(path_, key);
  if (node != nullptr && !node->is_table()) {
    state.problem(path_, key, node,
                  fmt::format("'{}' must be a table, not {}", dotted(path_, key), kind_of(*node)));
  }
  Path path = path_;
  path.emplace_back(key);
  state.asked[path];
  return {config_, std::move(path)};
}

bool TomlTable::has(std::string_view key) const {
  return config_->state_->peek(path_, key) != nullptr;
}

void TomlTable::error(std::string_view key, std::string_view message) const {
  TomlConfig::State& state = *config_->state_;
  state.problem(path_, key, state.peek(path_, key), fmt::format("'{}': {}", dotted(path_, key), message));
}

void TomlTable::require(std::string_view key) const {
  if (!has(key)) error(key, "is missing");
}

std::string did_you_mean(std::string_view word, std::span<const std::string> candidates) {
  std::string best;
  size_t best_distance = std::max<size_t>(2, word.size() / 3) + 1;
  for (const std::string& candidate : candidates) {
    const size_t distance = edit_distance(word, candidate);
    // A short word turns into any other in a few edits: more than half of it must stay.
    if (distance < best_distance && 2 * distance < std::max(word.size(), candidate.size()) + 1) {
      best = candidate;
      best_distance = distance;
    }
  }
  return best;
}

}  // namespace opaline
