// Folders of objects, bump maps and panoramas, split into training and test.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <map>
#include <memory>
#include <string>

#include "data/render/assets.h"

namespace opaline {

struct AssetConfig {
  std::string objects{};          ///< folder of .obj and .ply; "": none
  std::string bumps{};            ///< folder of grey .png
  std::string panoramas{};        ///< folder of .exr and .hdr
  double test_share = 0.15;       ///< of each folder's files
  int64_t panorama_height = 128;  ///< rows that larger panoramas are brought to

  bool any() const { return !objects.empty() || !bumps.empty() || !panoramas.empty(); }
};

/// Finds the files of each folder, at any depth. What lies under FOLDER/train and FOLDER/test, where there
/// are both, belongs to that split; else a hash of (seed, name) decides, so a file keeps its split when
/// others are added. Names are paths in the folder without their endings, and without ShapeNet's
/// /models/model_normalized.
///
/// Files are read when a scene draws them. One that cannot be used is left out and remembered with the
/// reason. Safe to use from several threads.
class AssetFolders {
 public:
  /// Throws UsageError where a folder is missing or leaves a split without files.
  AssetFolders(const AssetConfig& config, uint64_t seed, bool train, bool test);

  const render::Assets& train() const { return splits_[0]; }
  const render::Assets& test() const { return splits_[1]; }
  /// How many files of which names there are, as TOML lines: what a resumed run is compared with. "" without
  /// folders.
  const std::string& text() const { return text_; }
  /// File to reason, of what was drawn and could not be used.
  std::map<std::string, std::string> skipped() const;

 private:
  struct Log;
  std::array<render::Assets, 2> splits_;
  std::string text_;
  std::shared_ptr<Log> log_;
};

/// A grey PNG as a height map, brought to at most 256 texels a side by the mean. Colour is an error.
render::HeightMap read_height_map(const std::filesystem::path& path);

}  // namespace opaline
