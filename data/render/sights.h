// How a pinhole camera sees the points of the medium, straight through the surface.
//
// Facets are plane, so light goes from a point inside to the camera through a given facet on one way only,
// which Snell's law tells. The camera's rays into a facet fill a beam that widens slowly behind it. A grid
// over the body lists the beams that pass each of its cells; for those few the exact way is computed. So
// light that is traced from its source can be joined to the camera wherever it scatters
// (data/render/light_paths.h): nothing is left to chance, and nothing is approximated.
#pragma once

#include <array>
#include <bit>
#include <cstdint>
#include <span>
#include <vector>

#include "data/render/camera.h"
#include "data/render/mesh.h"
#include "data/render/vec3.h"

namespace opaline::render {

/// The way from a point inside through one facet to the camera. Whether anything blocks it is not known yet.
struct Sight {
  double x = 0;  ///< where the camera sees it, in pixels from the image's top left corner
  double y = 0;
  Vec3 surface;        ///< where the way leaves the body
  Vec3 normal;         ///< of the facet, unit, towards the exterior
  Vec3 direction;      ///< of the camera's ray outside, unit, towards the body
  Vec3 inside;         ///< .. and inside
  double cosine = 0;   ///< of the angle of incidence outside
  double length = 0;   ///< of the way inside, metres
  double section = 0;  ///< of a pixel's beam at the point, across it: m^2 a pixel
};

/// Every way of one camera and one body. Safe to use from several threads.
class Sights {
 public:
  /// `low` and `high` are the corners of the box around the mesh, `index` is the refractive index inside. The
  /// camera looks along -z from above the box.
  Sights(const Mesh& mesh, const Camera& camera, double index, const Vec3& low, const Vec3& high);

  /// Calls f(sight) for each facet through which the camera would see `point`, which lies inside.
  template <class F>
  void for_each(const Vec3& point, const F& f) const {
    Sight sight;
    for (const uint32_t bundle : near(point)) {
      for (uint32_t beams = may_pass(bundles_[bundle], point); beams != 0; beams &= beams - 1) {
        const auto lane = static_cast<size_t>(std::countr_zero(beams));
        if (find(facets_[bundle * kBundle + lane], point, sight)) f(sight);
      }
    }
  }

  /// No way from `point` is shorter inside than this; infinity where there is none.
  double shortest(const Vec3& point) const { return static_cast<double>(shortest_[cell(point)]); }

 private:
  struct Facet {
    Vec3 corner, normal;
    Vec3 u, v;  // gradients of the barycentric coordinates
  };
  /// Beams of neighbouring facets, which are looked at together, each made a little wider than it is. The way
  /// back from a point along a beam's middle to the facet's plane ends at the barycentric coordinates u and
  /// v; they and the depth below the facet are linear in the point.
  static constexpr size_t kBundle = 8;
  using Lanes = std::array<float, kBundle>;
  struct Bundle {
    std::array<Lanes, 4> depth{}, u{}, v{};  // times x, y, z, 1
    Lanes margin{}, widening{};              // of u and v, at the facet and by depth
  };
  using Corners = std::array<Vec3, 3>;

  void add_facet(const Corners& corners, size_t lane, double rounding);
  /// A bit for each beam that the point may lie in.
  static uint32_t may_pass(const Bundle& bundle, const Vec3& point);
  bool find(const Facet& facet, const Vec3& point, Sight& sight) const;
  std::span<const uint32_t> near(const Vec3& point) const {
    const size_t c = cell(point);
    return std::span(entries_).subspan(starts_[c], starts_[c + 1] - starts_[c]);
  }
  size_t cell(const Vec3& point) const;
  template <class F>
  void for_each_cell(std::span<const Facet> facets, std::span<const Corners> corners, const F& f) const;
  Vec3 refracted(const Vec3& surface, const Vec3& normal) const;

  Camera camera_;
  double index_;
  double scale_;  // of the image plane at distance 1: metres a pixel
  Vec3 low_{}, cell_{};
  std::array<int64_t, 3> cells_{};
  std::vector<Facet> facets_;               // that face the camera
  std::vector<Bundle> bundles_;             // of kBundle facets each
  std::vector<uint32_t> starts_, entries_;  // bundles of each cell
  std::vector<float> shortest_;             // from each cell to one of their facets
};

}  // namespace opaline::render
