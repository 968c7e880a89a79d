#include "data/render/solids.h"

#include <utility>

namespace opaline::render {
namespace {

std::array<float, 3> vertex(double x, double y, double z) {
  return {static_cast<float>(x), static_cast<float>(y), static_cast<float>(z)};
}

}  // namespace

Mesh make_box(const Vec3& low, const Vec3& high) {
  Mesh mesh = cube_sphere(1);
  for (auto& v : mesh.vertices) {
    v = vertex(v[0] > 0 ? high.x : low.x, v[1] > 0 ? high.y : low.y, v[2] > 0 ? high.z : low.z);
  }
  return mesh;
}

Mesh make_right_prism() {
  return {
      .vertices = {{-1, -1, 0}, {1, -1, 0}, {0, -1, -1}, {-1, 1, 0}, {1, 1, 0}, {0, 1, -1}},
      .triangles = {{0, 1, 4}, {0, 4, 3}, {1, 2, 5}, {1, 5, 4}, {2, 0, 3}, {2, 3, 5}, {0, 2, 1}, {3, 4, 5}}};
}

Mesh make_bowl(int sides, double thickness) {
  Mesh mesh = cube_sphere(sides);
  for (auto& v : mesh.vertices) {
    if (v[2] > 0.0F) v[2] *= static_cast<float>(thickness - 1.0);
  }
  return mesh;
}

Mesh make_shell(int sides, double inner) {
  const Mesh ball = cube_sphere(sides);
  return joined(ball, inverted(moved(ball, inner)));
}

Mesh make_pyramid(double width, double height) {
  return {.vertices = {{0, 0, 0},
                       vertex(-width, -width, height),
                       vertex(width, -width, height),
                       vertex(width, width, height),
                       vertex(-width, width, height)},
          .triangles = {{0, 2, 1}, {0, 3, 2}, {0, 4, 3}, {0, 1, 4}, {1, 2, 3}, {1, 3, 4}}};
}

Mesh joined(Mesh a, const Mesh& b) {
  const auto shift = static_cast<uint32_t>(a.vertices.size());
  a.vertices.insert(a.vertices.end(), b.vertices.begin(), b.vertices.end());
  for (const auto& t : b.triangles) a.triangles.push_back({t[0] + shift, t[1] + shift, t[2] + shift});
  return a;
}

Mesh moved(Mesh mesh, double scale, const Vec3& shift) {
  for (auto& v : mesh.vertices) {
    v = vertex(v[0] * scale + shift.x, v[1] * scale + shift.y, v[2] * scale + shift.z);
  }
  return mesh;
}

Mesh inverted(Mesh mesh) {
  for (auto& t : mesh.triangles) std::swap(t[1], t[2]);
  return mesh;
}

}  // namespace opaline::render
