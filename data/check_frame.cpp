#include "data/check_frame.h"

#include <fmt/format.h>

#include <cmath>

namespace opaline {
namespace {

struct Pixels {
  const Scene& scene;

  size_t at(int x, int y) const {
    return static_cast<size_t>(y) * static_cast<size_t>(scene.width) + static_cast<size_t>(x);
  }
  bool object(int x, int y) const {
    return x >= 0 && y >= 0 && x < scene.width && y < scene.height && scene.mask[at(x, y)] != 0;
  }
  double normal(int x, int y, size_t c) const { return static_cast<double>(scene.normal[3 * at(x, y) + c]); }
  double depth(int x, int y) const { return static_cast<double>(scene.depth[at(x, y)]); }
};

void add_silhouette(const Pixels& pixels, FrameEvidence& evidence) {
  constexpr int kReach = 2;
  for (const EdgePixel& edge : silhouette(pixels.scene, kReach)) {
    const double nx = pixels.normal(edge.x, edge.y, 0);
    const double ny = pixels.normal(edge.x, edge.y, 1);
    const double n = std::hypot(nx, ny);
    if (!(n > 0.3)) continue;
    evidence.outward_x += edge.out_x * nx / n;
    evidence.outward_y += edge.out_y * ny / n;
    evidence.silhouette += 1;
  }
}

}  // namespace

std::vector<EdgePixel> silhouette(const Scene& scene, int reach) {
  const Pixels pixels{scene};
  std::vector<EdgePixel> edge;
  for (int y = 1; y < scene.height - 1; ++y) {
    for (int x = 1; x < scene.width - 1; ++x) {
      if (!pixels.object(x, y)) continue;
      double out_x = 0;
      double out_y = 0;
      for (int dy = -reach; dy <= reach; ++dy) {
        for (int dx = -reach; dx <= reach; ++dx) {
          if (dx * dx + dy * dy > reach * reach + 1 || pixels.object(x + dx, y + dy)) continue;
          out_x += dx;
          out_y -= dy;
        }
      }
      const double out = std::hypot(out_x, out_y);
      if (out > 3) edge.push_back({x, y, out_x / out, out_y / out});
    }
  }
  return edge;
}

FrameEvidence& FrameEvidence::operator+=(const FrameEvidence& other) {
  outward_x += other.outward_x;
  outward_y += other.outward_y;
  silhouette += other.silhouette;
  slope_x += other.slope_x;
  slope_y += other.slope_y;
  slope_x_scale += other.slope_x_scale;
  slope_y_scale += other.slope_y_scale;
  towards += other.towards;
  return *this;
}

FrameEvidence frame_evidence(const Scene& scene) {
  FrameEvidence evidence;
  const Pixels pixels{scene};
  add_silhouette(pixels, evidence);
  double xx = 0;
  double yy = 0;
  double nxx = 0;
  double nyy = 0;
  for (int y = 1; y < scene.height - 1; ++y) {
    for (int x = 1; x < scene.width - 1; ++x) {
      if (!pixels.object(x, y)) continue;
      const bool whole = pixels.object(x - 1, y) && pixels.object(x + 1, y) && pixels.object(x, y - 1) &&
                         pixels.object(x, y + 1);
      if (!whole) continue;
      evidence.towards += pixels.normal(x, y, 2) > 0 ? 1 : -1;
      const double nz = std::abs(pixels.normal(x, y, 2));
      if (!(nz > 0.3)) continue;  // steep slopes run over occlusions
      const double gx = (pixels.depth(x + 1, y) - pixels.depth(x - 1, y)) / 2;
      const double gy = (pixels.depth(x, y - 1) - pixels.depth(x, y + 1)) / 2;
      const double px = -pixels.normal(x, y, 0) / nz;
      const double py = -pixels.normal(x, y, 1) / nz;
      evidence.slope_x += gx * px;
      evidence.slope_y += gy * py;
      xx += gx * gx;
      yy += gy * gy;
      nxx += px * px;
      nyy += py * py;
    }
  }
  evidence.slope_x_scale = std::sqrt(xx * nxx);
  evidence.slope_y_scale = std::sqrt(yy * nyy);
  return evidence;
}

FrameMatch match_frame(const FrameEvidence& e) {
  FrameMatch match;
  constexpr double kEnough = 20;
  if (e.silhouette < kEnough || !(e.slope_x_scale > 0 && e.slope_y_scale > 0)) return match;
  match.flip_x = e.outward_x < 0;
  match.flip_y = e.outward_y < 0;
  match.flip_z = e.towards < 0;
  match.silhouette = (std::abs(e.outward_x) + std::abs(e.outward_y)) / e.silhouette;
  const double x = (match.flip_x ? -1 : 1) * e.slope_x / e.slope_x_scale;
  const double y = (match.flip_y ? -1 : 1) * e.slope_y / e.slope_y_scale;
  match.flip_depth = x + y < 0;
  match.slope = (match.flip_depth ? -1 : 1) * (x + y) / 2;
  match.known = match.silhouette > 0.5 && x * y > 0 && match.slope > 0.3;
  return match;
}

std::string to_string(const FrameMatch& match) {
  const std::string strength =
      fmt::format("(silhouettes {:.2f}, slopes {:.2f})", match.silhouette, match.slope);
  if (!match.known) return "undecided " + strength;
  return fmt::format("x {}, y {}, z {} the camera, larger depth is {} {}", match.flip_x ? "left" : "right",
                     match.flip_y ? "down" : "up", match.flip_z ? "away from" : "towards",
                     match.flip_depth ? "farther" : "nearer", strength);
}

}  // namespace opaline
