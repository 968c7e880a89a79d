// Surfaces of implicit bodies.
#pragma once

#include <functional>

#include "data/render/surface.h"

namespace opaline::render {

/// A function of space, negative inside of the body, that changes between two points by at most their
/// distance (a signed distance, or less).
using Field = std::function<double(const Vec3&)>;

/// The closed surface of the body inside the cube of half-width `half`, by surface nets (Gibson, "Constrained
/// elastic surface nets", MICCAI 1998) on a grid of `cells`^3, vertices moved onto the zero of the field.
/// Where the grid is too coarse for the body, gaps under a cell are filled until each cell holds one sheet of
/// surface (a well-composed picture: Latecki, Eckhardt, Rosenfeld, "Well-composed sets", 1995), so the result
/// is a manifold whatever the field. What the body has within a cell of the cube's sides is cut off. Empty
/// where nothing is inside.
Surface extract_isosurface(const Field& field, double half, int cells);

}  // namespace opaline::render
