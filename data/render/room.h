// Procedural environments: rooms with coloured walls, windows and lamps, seen from their middle.
#pragma once

#include "core/random.h"
#include "data/render/light.h"

namespace opaline::render {

/// A room drawn from the stream, turned around the vertical axis; walls have a radiance of about 1, windows
/// of 5 to 100 and lamps of 50 to 1000 times that. `height` rows of texels, twice as many columns.
Environment make_room(Random& random, int64_t height = 64);

}  // namespace opaline::render
