// Closed bodies whose shape is known exactly, for validation: boxes, prisms, bowls, shells, and bodies that
// touch.
#pragma once

#include "data/render/mesh.h"

namespace opaline::render {

Mesh make_box(const Vec3& low, const Vec3& high);

/// A prism over a right-angled isosceles triangle: its hypotenuse, 2 wide, lies in z = 0 and faces +z.
Mesh make_right_prism();

/// The lower half of the unit ball, hollowed out from above to `thickness` at the bottom; the rim is a
/// knife's edge. `sides` is even.
Mesh make_bowl(int sides, double thickness);

/// The unit ball with a ball of radius `inner` left out in its middle.
Mesh make_shell(int sides, double inner);

/// A regular pyramid with its tip at the origin and its base, of half-width `width`, at z = `height`.
Mesh make_pyramid(double width, double height);

Mesh joined(Mesh a, const Mesh& b);
Mesh moved(Mesh mesh, double scale, const Vec3& shift = {});
/// Inside and outside exchanged.
Mesh inverted(Mesh mesh);

}  // namespace opaline::render
