// `opaline report`: one HTML page about a run that needs nothing else: curves and pictures are inside it.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>

#include "train/checkpoint.h"
#include "train/run_folder.h"

namespace opaline {

struct ReportOptions {
  std::filesystem::path data;  ///< empty: the config's data.path
  int64_t scenes = 6;          ///< test scenes shown, evenly spread over the ranking by normal error
  int64_t max_scenes = 500;    ///< test scenes measured; 0: all
};

/// Writes RUN/report.html and returns its path. Where the data set cannot be opened, or the run has no
/// checkpoint yet, `warn` says so and the page has what the log alone gives.
std::filesystem::path write_report(const RunFolder& run, const ReportOptions& options, const Warn& warn);

}  // namespace opaline
