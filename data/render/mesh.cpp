#include "data/render/mesh.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <numbers>
#include <utility>

namespace opaline::render {
namespace {

Vec3 point(const Mesh& mesh, uint32_t i) {
  const auto& v = mesh.vertices[i];
  return {v[0], v[1], v[2]};
}

// Numbers the surface points of the lattice {0..n}^3: bottom plane, top plane, then rings of 4n points.
struct SurfaceLattice {
  uint32_t n;

  uint32_t index(uint32_t i, uint32_t j, uint32_t k) const {
    const uint32_t plane = (n + 1) * (n + 1);
    if (k == 0) return j * (n + 1) + i;
    if (k == n) return plane + j * (n + 1) + i;
    uint32_t around = 0;
    if (j == 0 && i < n) {
      around = i;
    } else if (i == n && j < n) {
      around = n + j;
    } else if (j == n && i > 0) {
      around = 2 * n + (n - i);
    } else {
      around = 3 * n + (n - j);
    }
    return 2 * plane + (k - 1) * 4 * n + around;
  }
  uint32_t size() const { return 2 * (n + 1) * (n + 1) + (n - 1) * 4 * n; }
};

}  // namespace

Mesh cube_sphere(int sides) {
  const auto n = static_cast<uint32_t>(sides);
  const SurfaceLattice lattice{n};
  Mesh mesh;
  mesh.vertices.resize(lattice.size());
  mesh.triangles.reserve(size_t{12} * n * n);
  // Equal angles from the centre instead of equal steps on the cube: facets of more equal size.
  std::vector<double> warp(n + 1);
  for (uint32_t a = 0; a <= n; ++a)
    warp[a] = std::tan(0.25 * std::numbers::pi * (2.0 * static_cast<double>(a) / n - 1.0));

  for (uint32_t side = 0; side < 6; ++side) {
    const uint32_t axis = side / 2;
    const uint32_t fixed = side % 2 == 0 ? 0 : n;
    const auto vertex = [&](uint32_t a, uint32_t b) {
      std::array<uint32_t, 3> c{};
      c[axis] = fixed;
      c[(axis + 1) % 3] = a;
      c[(axis + 2) % 3] = b;
      const uint32_t id = lattice.index(c[0], c[1], c[2]);
      const Vec3 p = normalised({warp[c[0]], warp[c[1]], warp[c[2]]});
      mesh.vertices[id] = {static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z)};
      return id;
    };
    for (uint32_t b = 0; b < n; ++b) {
      for (uint32_t a = 0; a < n; ++a) {
        uint32_t v00 = vertex(a, b), v10 = vertex(a + 1, b), v11 = vertex(a + 1, b + 1),
                 v01 = vertex(a, b + 1);
        if (fixed == 0) std::swap(v10, v01);
        mesh.triangles.push_back({v00, v10, v11});
        mesh.triangles.push_back({v00, v11, v01});
      }
    }
  }
  return mesh;
}

double longest_edge(const Mesh& mesh) {
  double longest2 = 0.0;
  for (const auto& t : mesh.triangles) {
    for (size_t e = 0; e < 3; ++e) {
      const Vec3 edge = point(mesh, t[e]) - point(mesh, t[(e + 1) % 3]);
      longest2 = std::max(longest2, dot(edge, edge));
    }
  }
  return std::sqrt(longest2);
}

double enclosed_volume(const Mesh& mesh) {
  double six = 0.0;
  for (const auto& t : mesh.triangles)
    six += dot(point(mesh, t[0]), cross(point(mesh, t[1]), point(mesh, t[2])));
  return six / 6.0;
}

std::string describe_leak(const Mesh& mesh) {
  // A closed surface has each directed edge once and its reverse once.
  std::vector<std::pair<uint32_t, uint32_t>> edges, reversed;
  for (const auto& t : mesh.triangles) {
    for (size_t e = 0; e < 3; ++e) {
      const uint32_t a = t[e], b = t[(e + 1) % 3];
      if (a == b) return fmt::format("a triangle uses vertex {} twice", a);
      edges.emplace_back(a, b);
      reversed.emplace_back(b, a);
    }
  }
  std::sort(edges.begin(), edges.end());
  std::sort(reversed.begin(), reversed.end());
  for (size_t i = 0; i + 1 < edges.size(); ++i)
    if (edges[i] == edges[i + 1])
      return fmt::format("edge {}-{} has two triangles on one side", edges[i].first, edges[i].second);
  for (size_t i = 0; i < edges.size(); ++i)
    if (edges[i] != reversed[i])
      return fmt::format("edge {}-{} has a triangle on one side only", std::min(edges[i], reversed[i]).first,
                         std::min(edges[i], reversed[i]).second);
  return "";
}

}  // namespace opaline::render
