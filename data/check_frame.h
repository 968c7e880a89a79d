// In which frame normals and depth are, judged by what they are of.
#pragma once

#include <string>
#include <vector>

#include "data/scene.h"

namespace opaline {

/// A pixel just inside of the object's silhouette.
struct EdgePixel {
  int x = 0;
  int y = 0;
  double out_x = 0;  ///< unit direction out of the object, x right, y up
  double out_y = 0;
};
/// Pixels of the mask within `reach` of its end, except where that has no clear direction.
std::vector<EdgePixel> silhouette(const Scene& scene, int reach);

/// Evidence for the frame of normals and depth, as sums over pixels; sums of scenes add up.
struct FrameEvidence {
  /// Just inside silhouettes: outward direction (x right, y up) times the normal's direction in the image,
  /// per axis, and the number of pixels. Near +0.5 and +0.5 of it where both axes are as ours.
  double outward_x = 0;
  double outward_y = 0;
  double silhouette = 0;
  /// Depth differences to the right and upward against -nx / nz and -ny / nz: products and squares.
  double slope_x = 0;
  double slope_y = 0;
  double slope_x_scale = 0;  ///< product of the root sums of squares, summed over scenes
  double slope_y_scale = 0;
  double towards = 0;  ///< pixels whose normal points towards the camera, less those whose does not

  FrameEvidence& operator+=(const FrameEvidence& other);
};

/// Of a scene with normals and depth.
FrameEvidence frame_evidence(const Scene& scene);

/// What the evidence says.
struct FrameMatch {
  bool known = false;       ///< enough pixels, and no axis is ambiguous
  bool flip_x = false;      ///< normals' x points left
  bool flip_y = false;      ///< normals' y points down
  bool flip_z = false;      ///< normals' z points away from the camera
  bool flip_depth = false;  ///< larger depth is farther
  double silhouette = 0;    ///< mean cosine between outward and the normal after the flips
  double slope = 0;         ///< correlation of depth's slope with the normals' after the flips
  bool ours() const { return known && !flip_x && !flip_y && !flip_z && !flip_depth; }
  /// The same flips.
  bool agrees(const FrameMatch& other) const {
    return flip_x == other.flip_x && flip_y == other.flip_y && flip_z == other.flip_z &&
           flip_depth == other.flip_depth;
  }
};

FrameMatch match_frame(const FrameEvidence& evidence);
/// "x right, y up, z towards the camera, larger depth is nearer (silhouettes 0.95, slopes 0.99)".
std::string to_string(const FrameMatch& match);

}  // namespace opaline
