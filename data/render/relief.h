// Bumps: heights over a body's surface, for true displacement.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "core/random.h"
#include "data/render/surface.h"

namespace opaline::render {

/// Height at a point of a body of unit radius whose normal there is n; slopes up to about 1.
struct Relief {
  std::function<double(const Vec3& p, const Vec3& n)> height;
  double amplitude = 0.0;  ///< largest |height|, about
};

/// Noise: soft, ridged, cells or grooves.
Relief draw_noise_relief(Random& random);

/// A height map: grey values, rows from the top.
struct HeightMap {
  std::string name;
  int width = 0;
  int height = 0;
  std::vector<float> values;
};

/// The map laid over the body from three sides (triplanar: the three axis-parallel projections, weighted by
/// the fourth powers of the normal's components), mirrored at its borders, its heights scaled so that the
/// steepest step between neighbouring texels has slope 1. Size, turn and place are drawn. The map must
/// outlive it.
Relief draw_map_relief(const HeightMap& map, Random& random);

/// Moves the points along their normals by slope x height, by a fifth of the thinnest wall at most and by
/// less than the local radius of curvature, so that creases do not fold over.
void displace(Surface& surface, const Relief& relief, double slope);

}  // namespace opaline::render
