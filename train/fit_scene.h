// Brings a capture of any size to one that the networks take.
#pragma once

#include <cstdint>

#include "data/scene.h"

namespace opaline {

/// Scales the Stokes images down by exact area averages (in linear light, where averages mean something)
/// until the longer side is `size`, then pads both sides, centred, to the next multiple of 16 that is at
/// least 32; the padding is black and outside the mask. A mask pixel is set where at least half of it was
/// covered. A scene that is smaller is not scaled up; size 0 scales nothing. Ground-truth maps are dropped
/// where anything changes.
Scene fit_scene(const Scene& scene, int64_t size);

}  // namespace opaline
