#include "data/render/mesh.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <cstddef>
#include <map>
#include <numbers>
#include <numeric>
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

void remove_degenerate(Mesh& mesh) {
  float largest = 0.0F;
  for (const auto& v : mesh.vertices)
    for (const float c : v) largest = std::max(largest, std::abs(c));
  // Heights under this are noise: coordinates are rounded to 2^-24 of the largest.
  const double least = 0x1p-22 * static_cast<double>(largest);

  for (int pass = 0; pass < 8; ++pass) {
    std::vector<bool> taken(mesh.vertices.size(), false);
    std::vector<std::pair<uint32_t, uint32_t>> merges;                           // from, to
    std::map<std::pair<uint32_t, uint32_t>, std::pair<size_t, uint32_t>> flips;  // edge: triangle, its point
    for (size_t i = 0; i < mesh.triangles.size(); ++i) {
      const auto& t = mesh.triangles[i];
      std::array<double, 3> length{};
      for (size_t e = 0; e < 3; ++e) length[e] = norm(point(mesh, t[(e + 1) % 3]) - point(mesh, t[e]));
      const auto longest =
          static_cast<size_t>(std::max_element(length.begin(), length.end()) - length.begin());
      const auto shortest =
          static_cast<size_t>(std::min_element(length.begin(), length.end()) - length.begin());
      const double twice =
          norm(cross(point(mesh, t[1]) - point(mesh, t[0]), point(mesh, t[2]) - point(mesh, t[0])));
      if (twice > least * length[longest]) continue;
      if (taken[t[0]] || taken[t[1]] || taken[t[2]]) continue;
      for (const uint32_t v : t) taken[v] = true;
      if (length[shortest] <= 2.0 * least) {
        merges.emplace_back(t[shortest], t[(shortest + 1) % 3]);
      } else {
        flips[{t[(longest + 1) % 3], t[longest]}] = {i, t[(longest + 2) % 3]};
      }
    }
    if (merges.empty() && flips.empty()) return;

    if (!flips.empty()) {
      for (auto& t : mesh.triangles) {
        for (size_t e = 0; e < 3; ++e) {
          const auto found = flips.find({t[e], t[(e + 1) % 3]});
          if (found == flips.end()) continue;
          // (a, b, c) behind the edge and the degenerate (b, a, w): (a, w, c) and (w, b, c) instead.
          const uint32_t a = t[e], b = t[(e + 1) % 3], c = t[(e + 2) % 3];
          const auto [other, w] = found->second;
          t = {a, w, c};
          mesh.triangles[other] = {w, b, c};
          flips.erase(found);
          break;
        }
      }
    }
    std::vector<uint32_t> to(mesh.vertices.size());
    std::iota(to.begin(), to.end(), 0U);
    for (const auto& [from, target] : merges) to[from] = target;
    std::erase_if(mesh.triangles, [&](auto& t) {
      for (uint32_t& v : t) v = to[v];
      return t[0] == t[1] || t[1] == t[2] || t[2] == t[0];
    });
  }
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
  // A closed surface has each directed edge once and its reverse once. Edges are listed by their first
  // vertex.
  std::vector<uint32_t> begin(mesh.vertices.size() + 1, 0);
  for (const auto& t : mesh.triangles) {
    for (size_t e = 0; e < 3; ++e) {
      if (t[e] >= mesh.vertices.size()) {
        return fmt::format("a triangle uses vertex {} of {}", t[e], mesh.vertices.size());
      }
      if (t[e] == t[(e + 1) % 3]) return fmt::format("a triangle uses vertex {} twice", t[e]);
      ++begin[t[e] + 1];
    }
  }
  std::partial_sum(begin.begin(), begin.end(), begin.begin());
  std::vector<uint32_t> ends(3 * mesh.triangles.size()), next(begin.begin(), begin.end() - 1);
  for (const auto& t : mesh.triangles)
    for (size_t e = 0; e < 3; ++e) ends[next[t[e]]++] = t[(e + 1) % 3];
  for (uint32_t a = 0; a < mesh.vertices.size(); ++a) {
    const auto first = ends.begin() + begin[a], last = ends.begin() + begin[a + 1];
    std::sort(first, last);
    if (const auto twice = std::adjacent_find(first, last); twice != last) {
      return fmt::format("edge {}-{} has two triangles on one side", std::min(a, *twice),
                         std::max(a, *twice));
    }
  }
  for (uint32_t a = 0; a < mesh.vertices.size(); ++a) {
    for (uint32_t i = begin[a]; i < begin[a + 1]; ++i) {
      const uint32_t b = ends[i];
      if (!std::binary_search(ends.begin() + begin[b], ends.begin() + begin[b + 1], a)) {
        return fmt::format("edge {}-{} has a triangle on one side only", std::min(a, b), std::max(a, b));
      }
    }
  }
  return "";
}

}  // namespace opaline::render
