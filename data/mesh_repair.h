// Meshes from elsewhere, made fit for rendering: closed, facing outwards, free of intersections.
#pragma once

#include <cstdint>
#include <string>

#include "data/render/surface.h"

namespace opaline {

/// What had to be done.
struct MeshRepair {
  int64_t merged = 0;    ///< points that another one was at
  int64_t dropped = 0;   ///< triangles without area or doubled
  int64_t filled = 0;    ///< holes
  int64_t turned = 0;    ///< triangles that faced the wrong way
  int64_t cavities = 0;  ///< pieces inside an odd number of others, turned inwards
};

/// Welds points (to a millionth of the size), drops degenerate and doubled triangles, turns neighbours the
/// same way, fills holes whose border is short (at most 64 edges and a tenth of the size around; a fan around
/// their middle), turns each piece outwards, except pieces inside an odd number of others: these are
/// cavities. Fits the body into the unit ball and measures its thinnest walls. Throws Error with the reason
/// where the result would still not be closed, or where more than 1 in 200 rays meet it from a wrong side
/// (pieces that intersect each other or themselves).
MeshRepair repair_mesh(render::Surface& surface, const std::string& name);

}  // namespace opaline
