// Latitude-longitude pictures as environments.
#pragma once

#include <cstdint>
#include <filesystem>
#include <string>
#include <vector>

#include "data/render/light.h"

namespace opaline {

/// .exr or .hdr, in any case.
bool is_panorama_file(const std::filesystem::path& path);

/// An EXR (channels R, G, B of its first part that has them) or Radiance file, twice as wide as high, zenith
/// at the top. Larger ones become `height` rows by the mean over each texel's solid angle, so that no light
/// is lost. Another shape, values that are negative or not finite, and blackness are errors that say where.
render::Environment read_panorama(const std::filesystem::path& path, int64_t height);

/// The mean over solid angle; `texels` has `width` a row, half as many rows, at least `height` of them.
std::vector<render::Rgb> shrink_panorama(const std::vector<render::Rgb>& texels, int64_t width,
                                         int64_t height);

}  // namespace opaline
