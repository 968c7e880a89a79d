// Procedural environments: rooms with coloured walls, windows and lamps, seen from their middle.
#pragma once

#include "core/random.h"
#include "data/render/light.h"
#include "data/render/range.h"

namespace opaline::render {

struct RoomOptions {
  // Mild ones: sharp, bright lamps (contrasts to 1e5, radii from 2 degrees) take many more samples.
  Range contrast{100.0, 1000.0};  ///< radiance of a lamp / mean radiance of the walls, log-uniform
  Range lamp{10.0, 20.0};         ///< angular radius of a lamp, degrees, uniform; at least 0.5

  /// Rows of texels: the smallest lamp is four of them wide, at least 64.
  int64_t height() const;
};

/// A room drawn from the stream, turned around the vertical axis: up to three windows of 5 to 100 times the
/// walls' radiance, one to three lamps, discs of one colour each. Walls have a mean radiance of 1; the
/// environment has height() rows of texels, twice as many columns.
Environment make_room(Random& random, const RoomOptions& options = {});

}  // namespace opaline::render
