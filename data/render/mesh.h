// Triangle meshes.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "data/render/vec3.h"

namespace opaline::render {

struct Mesh {
  std::vector<std::array<float, 3>> vertices;
  std::vector<std::array<uint32_t, 3>> triangles;  ///< counter-clockwise seen from outside
};

/// The six sides of a cube, n x n quads each, projected to the unit sphere. Sides share their border
/// vertices, so the mesh is closed whatever the vertices are moved to.
Mesh cube_sphere(int n);

/// Removes triangles without a certain normal: lower than the rounding of their coordinates. Of a short edge
/// the two ends become one; a point on the opposite edge gets the neighbour behind that edge instead. What
/// was closed stays closed, except where a piece is that small all over.
void remove_degenerate(Mesh& mesh);

/// Length of the longest edge.
double longest_edge(const Mesh& mesh);

/// Volume inside by the divergence theorem; positive where triangles face outwards.
double enclosed_volume(const Mesh& mesh);

/// "" where every edge belongs to exactly two triangles that run through it in opposite directions, else what
/// is wrong.
std::string describe_leak(const Mesh& mesh);

}  // namespace opaline::render
