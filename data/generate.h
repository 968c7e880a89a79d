// Renders a data set: `opaline render`.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <map>
#include <string>

#include "data/generate_config.h"
#include "data/render/path.h"

namespace opaline {

enum class GenerateStep { kRender, kVerify };

struct GenerateOptions {
  /// Told at the beginning of each step and after each of its scenes: how many of how many are done. One call
  /// at a time.
  std::function<void(GenerateStep step, int64_t done, int64_t total)> progress = [](GenerateStep, int64_t,
                                                                                    int64_t) {};
  /// Asked before each scene; true ends the run after the scenes in progress.
  std::function<bool()> stop = [] { return false; };
};

struct GenerateResult {
  int64_t rendered = 0;  ///< scenes, now
  int64_t kept = 0;      ///< scenes that were there and whole
  int64_t verified = 0;  ///< files whose checksum was found right at the end
  int64_t damaged = 0;   ///< files whose checksum was not: they are among the rendered ones
  int64_t redrawn = 0;   ///< draws whose object left the picture or missed it
  int64_t clamped = 0;   ///< values too bright for half floats
  render::PathFaults faults;
  /// Files of the config's folders that scenes drew and could not use, with the reason.
  std::map<std::string, std::string> skipped;
  bool complete = false;  ///< every scene is there and verified
};

/// Renders what is missing of the data set in `root`, each scene on one thread. Training scenes come first. A
/// scene is a function of (seed, number): neither threads nor interruptions change a bit of it. A scene is in
/// the index only once its file is whole, so a killed run goes on where it was; what it left half-written is
/// removed. At the end every file of the index is read and its checksum compared; damaged ones are rendered
/// again.
///
/// One process at a time holds root/lock. Throws UsageError with the difference where `root`
/// holds a set of another config, Error where a file cannot be written (what is finished stays).
GenerateResult generate(const GenerateConfig& config, const std::filesystem::path& root,
                        const GenerateOptions& options = {});

}  // namespace opaline
