// Smooth random functions of space.
#pragma once

#include <cstdint>

#include "data/render/vec3.h"

namespace opaline::render {

/// Gradient noise on the integer lattice (Perlin, "Improving noise", SIGGRAPH 2002: quintic blend), about in
/// [-1, 1], zero at lattice points, gradient at most about 2. `key` chooses the function.
double gradient_noise(const Vec3& p, uint32_t key);

/// Sum over octaves of gradient_noise, each at twice the frequency and half the height.
double fractal_noise(const Vec3& p, uint32_t key, int octaves);

/// Distance to the nearest of random points, one in each cell of the integer lattice (Worley, "A cellular
/// texture basis function", SIGGRAPH 1996): 0 to about 1, slope 1.
double cell_noise(const Vec3& p, uint32_t key);

}  // namespace opaline::render
