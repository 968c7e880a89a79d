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

enum class Meeting { kNothing, kSurface, kLost };

/// Safe to query from several threads.
class Geometry {
 public:
  virtual ~Geometry() = default;

  /// The surface's facets; null where it has none.
  virtual const Mesh* mesh() const { return nullptr; }

  /// Nearest surface point at a distance up to `limit` along the unit vector `direction`.
  virtual bool intersect(const Vec3& origin, const Vec3& direction, double limit, Hit& hit) const = 0;

  /// The same for a camera's ray: kLost where it starts inside the surface.
  Meeting first(const Vec3& origin, const Vec3& direction, Hit& hit) const;
  /// The same for a ray that is known to be inside the surface or outside of it: what it meets, it leaves or
  /// enters. Rounding puts some starts inside on the wrong side of a facet: at sharp edges, where faces
  /// coincide, in media whose free paths are as short as the numbers' spacing. Their ray is given the surface
  /// point that it would have met (at distance 0 where that lies behind its start). kLost is what is left: a
  /// ray inside that meets nothing however far, or no way out.
  Meeting next(const Vec3& origin, const Vec3& direction, bool inside, double limit, Hit& hit) const;

  /// Whether the surface is met within `limit` by a ray that is inside and would leave, or that is outside
  /// and would enter: `next` without what it says of the hit, and quicker.
  virtual bool occluded(const Vec3& origin, const Vec3& direction, bool inside, double limit) const = 0;

  /// Where a ray that leaves `hit` along `direction` starts: moved off the surface, to the side that it goes
  /// to, by a few units in the last place of the query's numbers, so that it does not meet the facet again.
  Vec3 leave(const Hit& hit, const Vec3& direction) const {
    return hit.position + hit.normal * (dot(direction, hit.normal) > 0.0 ? offset_ : -offset_);
  }
  /// The same for a ray that goes on with `next`. Outside, where a miss is as good as a hit, it starts behind
  /// the facet that it leaves and cannot see, lest it miss a facet that touches that one.
  Vec3 start(const Hit& hit, const Vec3& direction, bool inside) const {
    if (inside) return leave(hit, direction);
    return hit.position + hit.normal * (dot(direction, hit.normal) > 0.0 ? -0.25 * offset_ : 0.25 * offset_);
  }
  /// A point inside that lies this side of `hit`, moved in where it is nearer to that facet than rays start.
  Vec3 keep_inside(const Vec3& point, const Hit& hit) const {
    const double depth = dot(hit.position - point, hit.normal);
    return depth < offset_ ? point - hit.normal * (offset_ - depth) : point;
  }
  /// How far a query has to look beyond a point to see every facet that the point is too near to, but for
  /// those that the ray all but grazes.
  double margin() const { return 64.0 * offset_; }

 protected:
  explicit Geometry(double offset) : offset_(offset) {}
  /// Nearest surface point at which the ray leaves the inside (`leaves`), or enters it.
  virtual bool intersect_side(const Vec3& origin, const Vec3& direction, double limit, bool leaves,
                              Hit& hit) const = 0;

 private:
  /// Whether the point is as near to the facet's plane as rays start.
  bool touches(const Vec3& point, const Hit& facet) const;

  double offset_;
};

/// A mesh behind Embree (robust mode). Throws Error where the mesh is not closed or Embree refuses it.
std::unique_ptr<Geometry> make_mesh_geometry(const Mesh& mesh);

/// The layer -thickness < z < 0 without lateral bounds; an infinite thickness is a half-space.
std::unique_ptr<Geometry> make_slab_geometry(double thickness);

}  // namespace opaline::render
