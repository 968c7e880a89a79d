// Names of the channels in a scene's EXR file, in the order in which the code holds them.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

namespace opaline {

/// Parts image and bsdf: the nine channels of a Stokes image (data/scene.h).
inline const std::vector<std::string> kStokesNames = {"S0.R", "S0.G", "S0.B", "S1.R", "S1.G",
                                                      "S1.B", "S2.R", "S2.G", "S2.B"};
/// Part truth.
inline const std::vector<std::string> kTruthNames = {"normal.X", "normal.Y", "normal.Z", "depth.Z", "mask.A"};
/// Part truth where the mask alone is wanted.
inline const std::vector<std::string> kMaskName = {"mask.A"};
inline constexpr size_t kTruthChannels = 5;

}  // namespace opaline
