// Families of closed random bodies. Each is a function from the unit sphere to space, so a sphere's mesh
// gives a closed mesh whatever the parameters, and bumps are true displacement.
#pragma once

#include <array>
#include <string_view>

#include "core/random.h"
#include "data/render/mesh.h"

namespace opaline::render {

enum class Family {
  kHarmonics,     ///< radius = 1 + smooth waves: pebbles and fruit
  kSuperquadric,  ///< from ball over cylinder to box (Barr, "Superquadrics and angle-preserving
                  ///< transformations", 1981)
  kBlend,         ///< smooth union of overlapping balls: figures with limbs and dents
  kTwisted        ///< superquadrics, tapered and twisted around their axis: vases and screws
};
inline constexpr std::array<std::string_view, 4> kFamilyNames = {"harmonics", "superquadric", "blend",
                                                                 "twisted"};

struct ShapeOptions {
  Family family = Family::kHarmonics;
  int sides = 64;        ///< quads along an edge of the cube that the sphere's mesh is made from
  double radius = 0.15;  ///< of the ball around the body, metres
  double bump = 0.3;     ///< largest slope of the bumps; 0: none
};

/// A body drawn from the family, turned at random, centred at the origin.
Mesh make_shape(const ShapeOptions& options, Random& random);

}  // namespace opaline::render
