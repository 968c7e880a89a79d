// Directions in which an interior point finds unscattered light.
//
// The surface is smooth, so a point of the medium cannot be connected to the flash by a straight line: light
// reaches it refracted, or totally reflected some times, from directions that only tracing tells. Hence light
// sub-paths are traced first, from the flash and the environment through the surface; in each cell of a grid
// that they pass they are counted by direction. A camera path then samples, at each scattering, one more
// direction from the counts of its cell, besides the one that the phase function gives, and the two join by
// multiple importance sampling (data/render/path.cpp). The guide only steers: whatever it holds, the estimate
// has the same expectation, and directions that it misses are left to the phase function.
#pragma once

#include <array>
#include <cstdint>
#include <deque>
#include <vector>

#include "core/random.h"
#include "data/render/vec3.h"

namespace opaline::render {

class Illumination;
struct World;

struct GuideOptions {
  int64_t photons = 131072;  ///< light sub-paths traced; 0: no guide
  int64_t cells = 16;        ///< along each side of the grid
};

/// Directions cut into bins: the sides of a cube around the origin, kSide x kSide bins each. Positions on a
/// side are warped so that bins are about equally wide in angle (3 to 3.8 degrees).
class DirectionBins {
 public:
  static constexpr int kSide = 24;
  static constexpr int kCount = 6 * kSide * kSide;
  /// Square patches of kPatch x kPatch bins, numbered like sides with fewer bins. Bins of a patch follow each
  /// other.
  static constexpr int kPatch = 4;
  static constexpr int kPatches = kCount / (kPatch * kPatch);

  /// The bin of the unit vector d, and the density there, per steradian, of directions that are uniform over
  /// the bin's part of the warped side.
  struct Place {
    int bin;
    double density;
  };
  static Place find(const Vec3& d);
  /// A direction in the bin, from two numbers in [0, 1).
  static Vec3 direction(int bin, double u, double v);
  /// The middle of a patch.
  static Vec3 patch_direction(int patch);
};

/// Safe to use from several threads.
class Guide {
 public:
  /// Steers nowhere.
  Guide() = default;
  /// Traces light into the world's surface; `low` and `high` are the corners of the box around it.
  Guide(const World& world, const Illumination& light, const Vec3& low, const Vec3& high, Random random,
        const GuideOptions& options = {});

  /// What a scattering at `position` of light that is to go along -`direction` (unit; where the path comes
  /// from) should look at: the cell's light times the phase function of mean cosine g.
  class Directions;
  Directions directions(const Vec3& position, const Vec3& direction, double g) const;

  /// How many times denser light is than if it came evenly from all directions, on the average over light and
  /// cells: about 1 under a uniform sky, over 100 under the flash. Near 1 the phase function alone does as
  /// well, for less time.
  double concentration() const { return concentration_; }

 private:
  struct Cell {
    std::array<float, DirectionBins::kCount> share;    // of the cell's light in each bin
    std::array<float, DirectionBins::kPatches> patch;  // sum over the bins of each patch
  };
  const Cell* find(const Vec3& position) const;
  int64_t cell_index(const Vec3& position) const;
  static void smooth(Cell& cell);

  Vec3 low_{};
  Vec3 cells_per_length_{};
  int64_t side_ = 0;
  std::vector<int32_t> slots_;  // of the grid's cells in cells_, -1 where no light came
  std::deque<Cell> cells_;      // large and growing: never moved
  double concentration_ = 0.0;
};

/// A distribution over directions, for as long as its guide lives.
class Guide::Directions {
 public:
  /// Whether there is any light to look at.
  bool known() const { return cell_ != nullptr; }
  /// A unit direction towards light. `pick` in [0, 1) chooses the patch of directions.
  Vec3 sample(double pick, Random& random) const;
  /// Density of that, per steradian; 0 where none is known.
  double density(const Vec3& direction) const;

 private:
  friend class Guide;
  const Cell* cell_ = nullptr;
  std::array<float, DirectionBins::kPatches> weight_;  // of each patch
  float total_ = 0.0F;
};

}  // namespace opaline::render
