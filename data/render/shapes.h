// Families of closed random bodies. Each is a closed surface of moderate size, refined until its facets suit
// the camera, with bumps by true displacement.
#pragma once

#include <array>
#include <string_view>

#include "core/random.h"
#include "data/render/mesh.h"
#include "data/render/relief.h"
#include "data/render/surface.h"

namespace opaline::render {

enum class Family {
  kHarmonics,     ///< radius = exp(real spherical harmonics up to degree 4 to 8): pebbles and fruit
  kNoise,         ///< radius = 1 + fractal noise: rocks and roots
  kSuperquadric,  ///< from ball over cylinder to box (Barr, "Superquadrics and angle-preserving
                  ///< transformations", 1981)
  kTwisted,       ///< superquadrics, tapered and twisted around their axis: screws
  kLathed,        ///< turned solids, some of them fluted: vases and chessmen
  kSheet,         ///< thin plates, rolled or wavy: tiles, leaves and crisps
  kBlend,         ///< primitives melted into each other; trees of limbs
  kCarved,        ///< primitives with dents, cavities and holes
  kTube,          ///< rings, knots and springs
  kVessel         ///< turned walls, open at the top: bowls, cups, bottles
};
inline constexpr std::array<std::string_view, 10> kFamilyNames = {
    "harmonics", "noise", "superquadric", "twisted", "lathed", "sheet", "blend", "carved", "tube", "vessel"};

struct ShapeOptions {
  double radius = 0.15;  ///< of the ball around the body, metres
  double bump = 0.3;     ///< largest slope of the bumps; 0: none
  /// Longest edge of a facet near a point of the finished body, metres.
  FacetLimit facet = [](const Vec3&) { return 0.004; };
  const HeightMap* map = nullptr;  ///< bumps from it; null: from noise
};

/// A body of the family before refinement: closed, within about the unit ball, upright.
Surface draw_body(Family family, Random& random);

/// The closed body turned at random, refined, displaced, scaled to the radius, centred at the origin.
Mesh finish_body(Surface body, const ShapeOptions& options, Random& random);

/// Both.
Mesh make_shape(Family family, const ShapeOptions& options, Random& random);

}  // namespace opaline::render
