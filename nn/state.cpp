#include "nn/state.h"

#include <algorithm>
#include <cmath>
#include <set>
#include <string>

namespace opaline {
namespace {

// One line a problem, so that a wrong file is recognised at a glance.
std::vector<std::string> differences(const std::vector<NamedTensor>& entries, const TensorMap& state,
                                     bool allow_non_finite) {
  std::vector<std::string> lines;
  std::set<std::string> known;
  for (const NamedTensor& entry : entries) {
    known.insert(entry.name);
    const auto found = state.find(entry.name);
    if (found == state.end()) {
      lines.push_back(fmt::format("missing: {} ({})", entry.name, to_string(entry.tensor.shape())));
      continue;
    }
    const Tensor& value = found->second;
    if (value.shape() != entry.tensor.shape()) {
      lines.push_back(fmt::format("shape: {} is {}, expected {}", entry.name, to_string(value.shape()),
                                  to_string(entry.tensor.shape())));
    } else if (value.is_floating() != entry.tensor.is_floating()) {
      lines.push_back(fmt::format("type: {} is {}, expected {}", entry.name, to_string(value.dtype()),
                                  to_string(entry.tensor.dtype())));
    } else if (!allow_non_finite && !all_finite(value)) {
      lines.push_back(fmt::format("not finite: {} holds NaN or infinities", entry.name));
    }
  }
  for (const auto& [name, value] : state) {
    if (!known.contains(name)) {
      lines.push_back(fmt::format("extra: {} ({})", name, to_string(value.shape())));
    }
  }
  return lines;
}

}  // namespace

TensorMap to_map(const std::vector<NamedTensor>& entries) {
  TensorMap map;
  for (const NamedTensor& entry : entries) {
    if (!map.emplace(entry.name, entry.tensor).second) fail("state", "two tensors named {}", entry.name);
  }
  return map;
}

bool all_finite(const Tensor& tensor) {
  if (!tensor.is_floating()) return true;
  return dispatch_floating("all_finite", tensor.dtype(), [&]<class T>() {
    return std::ranges::all_of(tensor.values<T>(), [](T value) { return std::isfinite(value); });
  });
}

void load_state(const std::vector<NamedTensor>& entries, const TensorMap& state,
                const LoadStateOptions& options) {
  const std::vector<std::string> lines = differences(entries, state, options.allow_non_finite);
  if (!lines.empty()) {
    fail(options.source, "does not fit: {} difference{} in {} expected tensors\n  {}", lines.size(),
         lines.size() == 1 ? "" : "s", entries.size(), fmt::join(lines, "\n  "));
  }
  for (const NamedTensor& entry : entries) {
    const Tensor& value = state.at(entry.name);
    Tensor target = entry.tensor;
    target.copy_from(value.dtype() == target.dtype() ? value : value.to(target.dtype()));
  }
}

}  // namespace opaline
