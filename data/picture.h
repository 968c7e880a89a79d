// 8-bit pictures of maps, for people: predictions and reports.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <vector>

#include "data/scene.h"

namespace opaline {

struct Picture {
  int width = 0;
  int height = 0;
  std::vector<uint8_t> rgb;  ///< H x W x 3
};

/// A map over an image: H x W x channels, and the mask that says where it counts.
struct MaskedMap {
  std::span<const float> values;
  std::span<const uint8_t> mask;
  int width = 0;
  int height = 0;
};

/// Gamma-encoded unpolarised intensity S0 / 2.
Picture picture_of_input(const Scene& scene);
/// (n + 1) / 2 of the normalised vectors; black outside the mask.
Picture picture_of_normals(const MaskedMap& normals);
/// Grey, from `low` (dark) to `high` (white), values outside clamped; black outside the mask.
Picture picture_of_depth(const MaskedMap& depth, float low, float high);
/// Degree of polarisation of the three colours together, as a heat map from 0 to `high`; black outside the
/// mask.
Picture picture_of_dop(const Scene& scene, float high = 0.5F);
/// Angle of polarisation as a hue (0 degrees red, 60 green, 120 blue), the darker the less of it; black
/// outside the mask.
Picture picture_of_aop(const Scene& scene);
/// A heat map from 0 (dark) over purple and orange to `high` (pale yellow); white outside the mask.
Picture picture_of_error(const MaskedMap& error, float high);

/// At most `side` pixels high and wide: averaged over blocks of whole pixels, or its pixels doubled, tripled
/// ..
Picture scaled_to(const Picture& picture, int side);

/// The colour that picture_of_error gives to a share of `high`.
std::array<uint8_t, 3> heat_colour(double share);

/// Smallest and largest value inside the mask; {0, 1} where it is empty.
struct ValueRange {
  float low = 0.0F;
  float high = 1.0F;
};
ValueRange range_inside(const MaskedMap& map);

void write_picture(const std::filesystem::path& path, const Picture& picture);
/// "data:image/png;base64,.." for an <img>.
std::string data_uri(const Picture& picture);

/// RFC 4648.
std::string base64(std::span<const std::byte> bytes);

}  // namespace opaline
