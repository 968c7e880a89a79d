// The released real captures: a folder a capture, p0.png p45.png p90.png p135.png mask.png and, where there,
// s0.npy s1.npy s2.npy.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "data/dataset.h"
#include "data/stored_light.h"

namespace opaline {

/// Reads <folder>/<prefix>0<suffix>.png .. <prefix>135<suffix>.png, gamma 2.2. 8-bit values were truncated
/// when they were written, so they decode as ((v + 0.5) / 255)^2.2 (16-bit ones likewise with 65535). Throws
/// Error naming a missing angle and sizes that differ.
PolariserImages read_polariser_images(const std::filesystem::path& folder, std::string_view prefix,
                                      std::string_view suffix = "");

/// Median of (I45 + I135) / (I0 + I90) over the well-exposed values of the masked pixels; 1 where there are
/// none. A perfect camera has 1 everywhere.
float pair_ratio(const PolariserImages& images, std::span<const uint8_t> mask);

/// Stokes image (H x W x 9) after scaling each pair to the mean of both, by `ratio` in the median.
std::vector<float> equalised_stokes(const PolariserImages& images, float ratio);

/// mask.png of the size given: 1 where the (first) channel is at its largest value, 255.
std::vector<uint8_t> read_mask(const std::filesystem::path& path, int width, int height);

/// One capture folder as a scene without truth; pair_ratio tells what was equalised. The PNGs decide; where
/// s0.npy to s2.npy are there too they give the light, without the 8 bits, and the PNGs their signs and the
/// pair ratio.
Scene read_capture(const std::filesystem::path& folder);

/// What a capture folder stores, nothing repaired.
StoredLight read_stored_capture(const std::filesystem::path& folder);

/// True where `root` is a capture folder or holds some.
bool has_captures(const std::filesystem::path& root);

/// All captures under a folder (or the one that it is), in Split::kTest, sorted by name.
std::unique_ptr<Dataset> open_captures(const std::filesystem::path& root);

}  // namespace opaline
