#include "data/render/geometry.h"

#include <embree3/rtcore.h>

#include <algorithm>
#include <cmath>
#include <cstring>

#include "core/error.h"

namespace opaline::render {
namespace {

struct DeviceDelete {
  void operator()(RTCDevice device) const { rtcReleaseDevice(device); }
};
struct SceneDelete {
  void operator()(RTCScene scene) const { rtcReleaseScene(scene); }
};
using DeviceHandle = std::unique_ptr<RTCDeviceTy, DeviceDelete>;
using SceneHandle = std::unique_ptr<RTCSceneTy, SceneDelete>;

double largest_coordinate(const Mesh& mesh) {
  float largest = 0.0F;
  for (const auto& v : mesh.vertices)
    for (const float c : v) largest = std::max(largest, std::abs(c));
  return static_cast<double>(largest);
}

class MeshGeometry final : public Geometry {
 public:
  // Single-precision rays near a coordinate c are off by about c 2^-24; eight such steps clear the facet.
  explicit MeshGeometry(const Mesh& mesh) : Geometry(largest_coordinate(mesh) * 0x1p-21), mesh_(mesh) {
    if (const std::string leak = describe_leak(mesh); !leak.empty()) {
      fail("render", "the mesh ({} triangles) is not closed: {}", mesh.triangles.size(), leak);
    }
    device_.reset(rtcNewDevice("threads=1"));
    check("device");
    scene_.reset(rtcNewScene(device_.get()));
    // The filter serves the queries that see one side of the facets.
    rtcSetSceneFlags(scene_.get(), RTC_SCENE_FLAG_ROBUST | RTC_SCENE_FLAG_CONTEXT_FILTER_FUNCTION);
    rtcSetSceneBuildQuality(scene_.get(), RTC_BUILD_QUALITY_MEDIUM);

    RTCGeometry geometry = rtcNewGeometry(device_.get(), RTC_GEOMETRY_TYPE_TRIANGLE);
    void* vertices = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_VERTEX, 0, RTC_FORMAT_FLOAT3,
                                             sizeof(mesh_.vertices[0]), mesh_.vertices.size());
    void* triangles = rtcSetNewGeometryBuffer(geometry, RTC_BUFFER_TYPE_INDEX, 0, RTC_FORMAT_UINT3,
                                              sizeof(mesh_.triangles[0]), mesh_.triangles.size());
    check("buffers");
    std::memcpy(vertices, mesh_.vertices.data(), mesh_.vertices.size() * sizeof(mesh_.vertices[0]));
    std::memcpy(triangles, mesh_.triangles.data(), mesh_.triangles.size() * sizeof(mesh_.triangles[0]));
    rtcCommitGeometry(geometry);
    rtcAttachGeometry(scene_.get(), geometry);
    rtcReleaseGeometry(geometry);
    rtcCommitScene(scene_.get());
    check("scene");
  }

  const Mesh* mesh() const override { return &mesh_; }

  bool intersect(const Vec3& origin, const Vec3& direction, double limit, Hit& hit) const override {
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
    return query(origin, direction, limit, context, hit);
  }

  bool occluded(const Vec3& origin, const Vec3& direction, bool inside, double limit) const override {
    SideContext context{.base = {}, .geometry = this, .direction = direction, .leaves = inside};
    rtcInitIntersectContext(&context.base);
    context.base.filter = &MeshGeometry::reject_other_side;
    RTCRay ray = single_ray(origin, direction, limit);
    rtcOccluded1(scene_.get(), &context.base, &ray);
    return ray.tfar < 0.0F;
  }

 protected:
  bool intersect_side(const Vec3& origin, const Vec3& direction, double limit, bool leaves,
                      Hit& hit) const override {
    SideContext context{.base = {}, .geometry = this, .direction = direction, .leaves = leaves};
    rtcInitIntersectContext(&context.base);
    context.base.filter = &MeshGeometry::reject_other_side;
    return query(origin, direction, limit, context.base, hit);
  }

 private:
  /// What the filter of a query that sees one side of the facets has to know.
  struct SideContext {
    RTCIntersectContext base;  // first: Embree hands back a pointer to it
    const MeshGeometry* geometry;
    Vec3 direction;
    bool leaves;
  };
  static void reject_other_side(const RTCFilterFunctionNArguments* arguments) {
    // One ray a query, hence packets of one.
    const auto* context = reinterpret_cast<const SideContext*>(arguments->context);
    const unsigned triangle = RTCHitN_primID(arguments->hit, arguments->N, 0);
    const bool leaves = dot(context->direction, context->geometry->normal(triangle)) > 0.0;
    if (leaves != context->leaves) arguments->valid[0] = 0;
  }

  static RTCRay single_ray(const Vec3& origin, const Vec3& direction, double limit) {
    RTCRay ray;
    ray.org_x = static_cast<float>(origin.x);
    ray.org_y = static_cast<float>(origin.y);
    ray.org_z = static_cast<float>(origin.z);
    ray.dir_x = static_cast<float>(direction.x);
    ray.dir_y = static_cast<float>(direction.y);
    ray.dir_z = static_cast<float>(direction.z);
    ray.tnear = 0.0F;
    ray.tfar = static_cast<float>(limit);
    ray.time = 0.0F;
    ray.mask = ~0U;
    ray.id = 0;
    ray.flags = 0;
    return ray;
  }

  bool query(const Vec3& origin, const Vec3& direction, double limit, RTCIntersectContext& context,
             Hit& hit) const {
    RTCRayHit query;
    query.ray = single_ray(origin, direction, limit);
    query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    rtcIntersect1(scene_.get(), &context, &query);
    if (query.hit.geomID == RTC_INVALID_GEOMETRY_ID) return false;

    // Position and normal from the triangle itself, in double precision.
    const auto& triangle = mesh_.triangles[query.hit.primID];
    const Vec3 a = vertex(triangle[0]), ab = vertex(triangle[1]) - a, ac = vertex(triangle[2]) - a;
    hit.distance = static_cast<double>(query.ray.tfar);
    hit.position = a + ab * static_cast<double>(query.hit.u) + ac * static_cast<double>(query.hit.v);
    hit.normal = normalised(cross(ab, ac));
    return true;
  }

  Vec3 normal(unsigned triangle) const {
    const auto& t = mesh_.triangles[triangle];
    const Vec3 a = vertex(t[0]);
    return cross(vertex(t[1]) - a, vertex(t[2]) - a);
  }
  Vec3 vertex(uint32_t i) const {
    const auto& v = mesh_.vertices[i];
    return {v[0], v[1], v[2]};
  }

  void check(const char* what) const {
    const RTCError error = rtcGetDeviceError(device_.get());
    if (error != RTC_ERROR_NONE) {
      fail("render", "Embree cannot make its {} (error {}) for {} triangles", what, static_cast<int>(error),
           mesh_.triangles.size());
    }
  }

  Mesh mesh_;
  DeviceHandle device_;
  SceneHandle scene_;
};

// Positions on a face are exact, and which face a ray meets follows from its direction: no offset needed.
class SlabGeometry final : public Geometry {
 public:
  explicit SlabGeometry(double thickness) : Geometry(0.0), bottom_(-thickness) {}

  bool intersect(const Vec3& origin, const Vec3& direction, double limit, Hit& hit) const override {
    const bool up = direction.z > 0.0;
    double face = 0.0;
    if (origin.z > 0.0 || (origin.z >= 0.0 && up)) {  // above, or leaving through the top
      if (up) return false;
    } else if (origin.z < bottom_ || (origin.z <= bottom_ && !up)) {  // below
      if (!up) return false;
      face = bottom_;
    } else {
      face = up ? 0.0 : bottom_;
    }
    if (!(std::abs(direction.z) > 0.0) || std::isinf(face)) return false;
    hit.distance = (face - origin.z) / direction.z;
    if (hit.distance > limit) return false;
    hit.position = origin + direction * hit.distance;
    hit.position.z = face;
    hit.normal = {0.0, 0.0, face < 0.0 ? -1.0 : 1.0};
    return true;
  }

  bool occluded(const Vec3& origin, const Vec3& direction, bool inside, double limit) const override {
    Hit hit;
    return intersect_side(origin, direction, limit, inside, hit);
  }

 protected:
  bool intersect_side(const Vec3& origin, const Vec3& direction, double limit, bool leaves,
                      Hit& hit) const override {
    return intersect(origin, direction, limit, hit) && (dot(direction, hit.normal) > 0.0) == leaves;
  }

 private:
  double bottom_;
};

}  // namespace

Meeting Geometry::next(const Vec3& origin, const Vec3& direction, bool inside, double limit, Hit& hit) const {
  if (!inside) {
    return intersect_side(origin, direction, limit, false, hit) ? Meeting::kSurface : Meeting::kNothing;
  }
  const bool found = intersect(origin, direction, limit, hit);
  if (found && dot(direction, hit.normal) > 0.0) return Meeting::kSurface;
  if (!found && std::isfinite(limit)) return Meeting::kNothing;

  // The facet that was met may be the twin of the right one, or its neighbour across an edge.
  Hit right;
  const bool ahead = found && intersect_side(origin, direction, limit, true, right);
  if (!ahead || !touches(hit.position, right)) {
    // A facet that should have been met lies just behind the start; seen backwards, leaving is entering.
    // Or the start, which lies past the facet that was met, should not see it.
    if (Hit behind; intersect_side(origin, -direction, kInfinity, false, behind) && touches(origin, behind)) {
      right = behind;
      right.distance = 0.0;
    } else if (!ahead || !touches(origin, hit)) {
      return Meeting::kLost;
    }
  }
  hit = right;
  return Meeting::kSurface;
}

Meeting Geometry::first(const Vec3& origin, const Vec3& direction, Hit& hit) const {
  if (!intersect(origin, direction, kInfinity, hit)) return Meeting::kNothing;
  if (dot(direction, hit.normal) < 0.0) return Meeting::kSurface;
  // A start inside sees facets from behind whichever way it looks. Outside it is rounding at an edge: the ray
  // misses the near one of two facets and touches the far one.
  if (Hit opposite;
      intersect(origin, -direction, kInfinity, opposite) && dot(-direction, opposite.normal) > 0.0) {
    return Meeting::kLost;
  }
  return intersect_side(origin, direction, kInfinity, false, hit) ? Meeting::kSurface : Meeting::kNothing;
}

bool Geometry::touches(const Vec3& point, const Hit& facet) const {
  // Rays start at one offset from the facet that they leave.
  return std::abs(dot(point - facet.position, facet.normal)) <= 4.0 * offset_;
}

std::unique_ptr<Geometry> make_mesh_geometry(const Mesh& mesh) {
  return std::make_unique<MeshGeometry>(mesh);
}

std::unique_ptr<Geometry> make_slab_geometry(double thickness) {
  if (!(thickness > 0.0)) fail_usage("render", "thickness of a slab must be positive, not {}", thickness);
  return std::make_unique<SlabGeometry>(thickness);
}

}  // namespace opaline::render
