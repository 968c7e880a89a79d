// Ray queries against a closed surface between the exterior and one medium.
#pragma once

#include <limits>
#include <memory>

#include "data/render/mesh.h"
#include "data/render/vec3.h"

namespace opaline::render {

inline constexpr double kInfinity = std::numeric_limits<double>::infinity();

struct Hit {
  double distance = 0;
  Vec3 position;
  Vec3 normal;  ///< unit, geometric, towards the exterior
};

/// Safe to query from several threads.
class Geometry {
 public:
  virtual ~Geometry() = default;

  /// Nearest surface point at a distance up to `limit` along the unit vector `direction`.
  virtual bool intersect(const Vec3& origin, const Vec3& direction, double limit, Hit& hit) const = 0;

  /// Where a ray that leaves `hit` along `direction` starts: moved off the surface, to the side that it goes
  /// to, by a few units in the last place of the query's numbers, so that it does not meet the facet again.
  Vec3 leave(const Hit& hit, const Vec3& direction) const {
    return hit.position + hit.normal * (dot(direction, hit.normal) > 0.0 ? offset_ : -offset_);
  }

 protected:
  explicit Geometry(double offset) : offset_(offset) {}

 private:
  double offset_;
};

/// A mesh behind Embree (robust mode). Throws Error where the mesh is not closed or Embree refuses it.
std::unique_ptr<Geometry> make_mesh_geometry(const Mesh& mesh);

/// The layer -thickness < z < 0 without lateral bounds; an infinite thickness is a half-space.
std::unique_ptr<Geometry> make_slab_geometry(double thickness);

}  // namespace opaline::render
