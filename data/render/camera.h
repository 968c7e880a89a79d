// The camera.
#pragma once

#include "data/render/vec3.h"

namespace opaline::render {

struct CameraRay {
  Vec3 origin;
  Vec3 direction;  ///< unit
  Vec3 axis;       ///< unit, across `direction`: 0 degrees of the polariser
};

/// A pinhole at (0, 0, 0.7) that looks along -z. Pixels are square; `field` is the horizontal angle.
struct Camera {
  int width = 64;
  int height = 64;
  Vec3 position{0.0, 0.0, 0.7};
  double field = 39.3;  ///< degrees

  /// The ray through the point (x, y) of the image, in pixels from the top left corner.
  CameraRay ray(double x, double y) const;
  /// Width of a pixel at depth z.
  double pixel_size(double z) const;
};

}  // namespace opaline::render
