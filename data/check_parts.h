// What the checks of a data set share. Internal to them.
#pragma once

#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "data/check.h"

namespace opaline {

/// Smallest, mean and largest of the scenes that were read.
struct Spread {
  double min = 0;
  double mean = 0;
  double max = 0;
  int64_t count = 0;
};
Spread spread(const SplitCheck& split, const std::function<std::optional<double>(const SceneCheck&)>& value);

/// A line of the tables of numbers by split.
struct Statistic {
  std::string name;
  std::function<std::optional<double>(const SceneCheck&)> value;
};
const std::vector<Statistic>& statistics();

/// The parameter of parameter_ranges(), where scenes have them.
std::function<std::optional<double>(const SceneCheck&)> parameter_value(size_t parameter);

/// Scenes by parameter value: `bins` equal parts of its range, values outside left out.
std::vector<int64_t> histogram(const SplitCheck& split, size_t parameter, size_t bins);

/// The findings that all layouts share; those that are bad become problems of the set, unless scenes have
/// them.
void add_findings(const Dataset& dataset, DatasetCheck& check);

/// Adds a finding, and its text to the set's problems or warnings.
void judge(DatasetCheck& check, const Finding& finding);

/// What our own layout promises besides its scenes: adds problems, warnings and findings.
void check_scene_set(const Dataset& dataset, DatasetCheck& check);

}  // namespace opaline
