// The released synthetic set (ECCV 2024): train.csv and test.csv, a folder of PNG and npy files a scene.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "data/dataset.h"

namespace opaline {

/// A line of the CSV, in our units.
struct ReleasedRecord {
  std::string id;                  ///< name of the scene's folder
  float flash = 0;                 ///< radiance
  std::array<float, 3> sigma_t{};  ///< per metre (the file's 0 to 1 times 32)
  std::array<float, 3> albedo{};
  float g = 0;
};

/// Parses one line; `where` names file and line in messages. 19 columns separated by semicolons: scene; obj;
/// envmap; normal; radiance; sigma_t; albedo; g; obj_scale; three rotations; three translations; three
/// rotations of the environment; uv_scale. Numbers have decimal points, whatever the locale.
ReleasedRecord parse_released_record(std::string_view line, std::string_view where);

/// The release's erosion: pixel (i, j) stays where all of (i - 1 .. i, j - 1 .. j) are set, outside counting
/// as unset.
std::vector<uint8_t> erode_mask(std::span<const uint8_t> mask, int width, int height);

/// Opens ROOT. Light comes from the four polariser PNGs (8 bits, gamma 2.2), which leave no doubt about
/// signs. The frames of normals, depth and SH are not documented: they are passed on as they are, and
/// `check-data` tells which flips they agree with.
std::unique_ptr<Dataset> open_released_set(const std::filesystem::path& root);

}  // namespace opaline
