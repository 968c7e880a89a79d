// Closed surfaces on their way to a mesh: made coarse, refined to the camera's pixels, displaced.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <vector>

#include "data/render/mesh.h"
#include "data/render/vec3.h"

namespace opaline::render {

struct Surface {
  std::vector<Vec3> points;
  std::vector<std::array<uint32_t, 3>> triangles;  ///< counter-clockwise seen from outside
  bool curved = true;      ///< samples of a smooth body; false: the triangles are the body
  double thickness = 2.0;  ///< of its thinnest wall, in units of the points
};

/// Length of the longest edge that is wanted around a point; changes slowly, by less than a fifth of the way.
using FacetLimit = std::function<double(const Vec3&)>;

/// Mean of the adjacent triangles' normals, weighted by their angles at the point; unit.
std::vector<Vec3> vertex_normals(const Surface& surface);

/// Splits edges until each is at most as long as the limit at its middle; a closed surface stays closed. The
/// middle of an edge is put on the cubic that meets both ends at right angles to their normals (Vlachos et
/// al., "Curved PN triangles", I3D 2001) where the surface is curved, on the edge elsewhere. An error where
/// that takes over 2^25 triangles.
void refine(Surface& surface, const FacetLimit& limit);

/// Removes every connected piece but the one of the largest volume.
void keep_largest_piece(Surface& surface);

/// In single precision, without degenerate triangles.
Mesh to_mesh(const Surface& surface);
Surface to_surface(const Mesh& mesh);

}  // namespace opaline::render
