// Scattered light traced from the flash and the environment, and joined to the camera wherever it scatters.
//
// A camera path has to find the light, through a surface that bends it: a flash seen over total reflections
// is found rarely, and each find is bright. Light that starts at its source has nothing to find. It is
// refracted in, scatters, and at every scattering goes to the camera on each of the few ways that there are
// (data/render/sights.h), so one path serves many pixels and one pixel is served by all paths.
//
// What the camera sees otherwise than straight through the surface (after reflections, inside or outside) is
// left to camera paths (PathParts::direct).
#pragma once

#include <cstdint>
#include <functional>
#include <span>

#include "data/render/emitter.h"
#include "data/render/sights.h"
#include "data/render/walk.h"

namespace opaline::render {

/// Light of one scattering in one pixel: rows x light for the Stokes components and colours.
struct Splat {
  uint32_t pixel;  ///< row by row from the top
  std::array<float, 3> rows;
  std::array<float, 3> light;

  /// S0, mean over colours.
  double brightness() const { return double{rows[0]} * (double{light[0]} + light[1] + light[2]) / 3.0; }
};

class LightTracer {
 public:
  /// All arguments must outlive it. `world` must have facets (Geometry::mesh).
  LightTracer(const World& world, const Illumination& light, const Camera& camera, const Vec3& low,
              const Vec3& high);

  /// Whether light paths can stand in for camera paths here.
  bool possible() const { return !emitter_.dark() && emitter_.complete(); }

  struct Options {
    int64_t paths = 0;
    /// Splats of less S0 (mean over colours) than this are thinned out, without bias; 0: none.
    double faint = 0.0;
    uint64_t seed = 0;
    uint32_t pass = 0;    ///< of the streams: passes share no numbers
    uint32_t number = 0;  ///< of the scene
  };
  using Sink = std::function<void(std::span<const Splat>)>;
  /// Hands the splats of all paths to `sink`, in the same order for any number of threads. A pixel's light
  /// is their sum over `paths`.
  void trace(const Options& options, const Sink& sink, PathFaults& faults) const;

 private:
  /// Of a path's numbers those that come from a sequence: where it starts, and its first flight inside.
  static constexpr size_t kNumbers = Emitter::kDimensions + 2;

  void trace_path(const std::array<double, kNumbers>& u, double faint, Random& random,
                  std::vector<Splat>& splats, PathFaults& faults) const;
  void join(const Ray& ray, const Rgb& beta, double faint, Random& random, std::vector<Splat>& splats) const;

  const World& world_;
  Camera camera_;
  double pixel_;  // area of a pixel at distance 1
  Emitter emitter_;
  Sights sights_;
};

}  // namespace opaline::render
