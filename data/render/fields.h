// Random implicit bodies: smooth unions and differences of primitives, tubes, vessels.
#pragma once

#include "core/random.h"
#include "data/render/isosurface.h"

namespace opaline::render {

/// An implicit body, about of unit size.
struct ImplicitBody {
  Field field;
  double half = 1.0;       ///< half-width of a cube around it, with air
  double thickness = 0.1;  ///< of its thinnest wall or limb, about
};

/// Spheres, boxes, cylinders, capsules and rings, each set on an earlier one and melted into it, or a tree of
/// limbs.
ImplicitBody draw_blend(Random& random);
/// A blend with dents, cavities and holes cut by other primitives.
ImplicitBody draw_carved(Random& random);
/// A ring, a knot or a spring: a tube of changing width along a curve.
ImplicitBody draw_tube(Random& random);
/// A bowl, cup, vase or bottle: a turned wall of even thickness, open at the top, some with a handle.
ImplicitBody draw_vessel(Random& random);

}  // namespace opaline::render
