// Where light starts that is traced from its source.
#pragma once

#include <cstddef>
#include <span>

#include "data/render/light.h"
#include "data/render/vec3.h"

namespace opaline::render {

struct LightRay {
  Vec3 origin;
  Vec3 direction;  ///< unit
  /// Radiance over the density of such rays: the mean of flux x f over rays is the integral of radiance x f
  /// over solid angle and area across it.
  Rgb flux;
};

/// Rays of light towards a ball: from the flash and the environment about in proportion to what they send
/// there.
class Emitter {
 public:
  /// Numbers in [0, 1) that a ray is made from.
  static constexpr size_t kDimensions = 5;

  /// `light` must outlive it.
  Emitter(const Illumination& light, const Vec3& centre, double radius);

  bool dark() const { return dark_; }
  /// Whether it emits every ray from the light to the ball: not where the flash is too near.
  bool complete() const { return complete_; }
  LightRay emit(std::span<const double, kDimensions> u) const;

 private:
  const Illumination& light_;
  Vec3 centre_;
  double radius_;
  double flash_share_ = 0.0;
  double flash_widening_ = 1.0;
  bool dark_ = true;
  bool complete_ = true;
};

}  // namespace opaline::render
