// Directions in which an interior point finds unscattered light.
//
// The surface is smooth, so a point of the medium cannot be connected to the flash by a straight line: light
// reaches it refracted, or totally reflected some times, from directions that only tracing tells. Hence light
// sub-paths are traced first, from the flash and the environment through the surface; each leaves its
// direction in the cells of a grid that it passes. A camera path then samples, at each scattering, one more
// direction from those of its cell (blurred), besides the one that the phase function gives, and the two join
// by multiple importance sampling (balance heuristic). The guide only steers: whatever it holds, the estimate
// has the same expectation, and directions that it misses are left to the phase function.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "core/random.h"
#include "data/render/vec3.h"

namespace opaline::render {

class Illumination;
struct World;

struct GuideOptions {
  int64_t photons = 8192;  ///< light sub-paths traced
  int64_t cells = 16;      ///< along each side of the grid
};

/// Safe to use from several threads.
class Guide {
 public:
  /// Steers nowhere.
  Guide() = default;
  /// Traces light into the world's surface; `low` and `high` are the corners of the box around it.
  Guide(const World& world, const Illumination& light, const Vec3& low, const Vec3& high, Random random,
        const GuideOptions& options = {});

  /// A unit direction from `position` towards light; false where none is known.
  bool sample(const Vec3& position, Random& random, Vec3& direction) const;
  /// Density of that, per steradian; 0 where none is known.
  double density(const Vec3& position, const Vec3& direction) const;

 private:
  static constexpr size_t kDirections = 16;
  struct Cell {
    bool known = false;
    std::array<Vec3, kDirections> directions{};
  };
  const Cell* find(const Vec3& position) const;

  Vec3 low_{};
  Vec3 cells_per_length_{};
  int64_t side_ = 0;
  std::vector<Cell> cells_;
};

}  // namespace opaline::render
