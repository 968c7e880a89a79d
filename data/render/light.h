// Where light comes from: an environment at infinity and a spherical flash around the camera's axis.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "core/random.h"
#include "data/render/vec3.h"

namespace opaline::render {

/// Spherical-harmonics coefficients of bands 0 to 2: real, orthonormal, no Condon-Shortley sign, polar axis
/// +z, order (0,0) (1,-1) (1,0) (1,1) (2,-2) .. (2,2).
using Harmonics = std::array<double, 9>;
/// The nine functions in the direction of the unit vector d.
Harmonics harmonics(const Vec3& d);

/// Radiance from every direction: a latitude-longitude grid around the vertical axis (+y), read bilinearly.
class Environment {
 public:
  /// The same radiance everywhere.
  explicit Environment(const Rgb& radiance) : Environment({radiance}, 1) {}
  /// `texels` row by row from the zenith down, `width` a row; longitude grows from -z towards +x.
  Environment(std::vector<Rgb> texels, int64_t width);

  int64_t width() const { return width_; }
  int64_t height() const { return height_; }

  /// Radiance that arrives from the direction of the unit vector d.
  Rgb radiance(const Vec3& d) const;
  /// Integral of radiance over the sphere, in each colour.
  Rgb fluence() const;
  /// Irradiance of a plane whose normal is the unit vector n.
  Rgb irradiance(const Vec3& n) const;
  /// Coefficients of the radiance, colour by colour.
  std::array<Harmonics, 3> project() const;
  /// A direction to the light, about proportional to its brightness (the texel's mean, uniform inside of it),
  /// from three numbers in [0, 1). Needs light.
  Vec3 sample(double pick, double u, double v) const;
  /// Density of that, per steradian; 0 only where all is dark.
  double density(const Vec3& d) const;

  void scale(double factor);
  /// Turns it around the vertical axis by this share of a whole turn, rounded to columns.
  void turn(double share);

 private:
  void accumulate();
  /// Height of a row's part of the unit sphere.
  double band(int64_t row) const;
  // Sum over sub-texel points of f(direction, radiance, solid angle).
  template <class F>
  void integrate(const F& f) const;

  std::vector<Rgb> texels_;
  int64_t width_;
  int64_t height_;
  std::vector<double> cumulative_;  // of brightness x solid angle, a value a texel
};

/// A sphere of uniform radiance. Camera rays do not see it.
struct Flash {
  Vec3 centre{0.0, 0.0, 0.8};
  double radius = 0.1;
  double radiance = 0.0;

  /// Whether the ray meets it.
  bool hit(const Vec3& origin, const Vec3& direction) const;
  /// Irradiance of a plane at `point` that faces it: pi L (r / d)^2.
  double irradiance(const Vec3& point) const;
};

/// What a path sees when it leaves the scene: unpolarised radiance.
class Light {
 public:
  virtual ~Light() = default;
  /// That arrives against a ray that has met the object before.
  virtual Rgb radiance(const Vec3& origin, const Vec3& direction) const = 0;
  /// That a camera ray sees which misses the object.
  virtual Rgb background(const Vec3& direction) const = 0;
};

class Illumination final : public Light {
 public:
  Environment environment{Rgb{}};
  Flash flash{};

  Rgb radiance(const Vec3& origin, const Vec3& direction) const override {
    if (flash.radiance > 0.0 && flash.hit(origin, direction)) {
      return {flash.radiance, flash.radiance, flash.radiance};
    }
    return environment.radiance(direction);
  }
  Rgb background(const Vec3& direction) const override { return environment.radiance(direction); }
};

}  // namespace opaline::render
