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
    rtcSetSceneFlags(scene_.get(), RTC_SCENE_FLAG_ROBUST);
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

  bool intersect(const Vec3& origin, const Vec3& direction, double limit, Hit& hit) const override {
    RTCRayHit query;
    query.ray.org_x = static_cast<float>(origin.x);
    query.ray.org_y = static_cast<float>(origin.y);
    query.ray.org_z = static_cast<float>(origin.z);
    query.ray.dir_x = static_cast<float>(direction.x);
    query.ray.dir_y = static_cast<float>(direction.y);
    query.ray.dir_z = static_cast<float>(direction.z);
    query.ray.tnear = 0.0F;
    query.ray.tfar = static_cast<float>(limit);
    query.ray.time = 0.0F;
    query.ray.mask = ~0U;
    query.ray.id = 0;
    query.ray.flags = 0;
    query.hit.geomID = RTC_INVALID_GEOMETRY_ID;
    RTCIntersectContext context;
    rtcInitIntersectContext(&context);
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

 private:
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

 private:
  double bottom_;
};

}  // namespace

std::unique_ptr<Geometry> make_mesh_geometry(const Mesh& mesh) {
  return std::make_unique<MeshGeometry>(mesh);
}

std::unique_ptr<Geometry> make_slab_geometry(double thickness) {
  if (!(thickness > 0.0)) fail_usage("render", "thickness of a slab must be positive, not {}", thickness);
  return std::make_unique<SlabGeometry>(thickness);
}

}  // namespace opaline::render
