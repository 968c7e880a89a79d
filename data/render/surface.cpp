#include "data/render/surface.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/error.h"

namespace opaline::render {
namespace {

constexpr double kMostTriangles = 1 << 25;
/// Cosine between the normals at an edge's ends under which it is too coarse a sample to bend: sharp rims.
constexpr double kSharpest = 0.4;
constexpr uint32_t kNone = UINT32_MAX;

/// The edges to split, by the lower of their two points, and the number of each one's middle.
class SplitEdges {
 public:
  SplitEdges(const Surface& surface, const FacetLimit& limit) : begin_(surface.points.size() + 1, 0) {
    std::vector<std::pair<uint32_t, uint32_t>> found;  // once for each of the edge's two triangles
    for (const auto& t : surface.triangles) {
      for (size_t e = 0; e < 3; ++e) {
        const uint32_t a = std::min(t[e], t[(e + 1) % 3]), b = std::max(t[e], t[(e + 1) % 3]);
        const Vec3 edge = surface.points[b] - surface.points[a];
        const double longest = limit((surface.points[a] + surface.points[b]) * 0.5);
        if (dot(edge, edge) <= longest * longest) continue;
        found.emplace_back(a, b);
        ++begin_[a + 1];
      }
    }
    std::partial_sum(begin_.begin(), begin_.end(), begin_.begin());
    ends_.resize(found.size());
    std::vector<uint32_t> next(begin_.begin(), begin_.end() - 1);
    for (const auto& [a, b] : found) ends_[next[a]++] = {b, kNone};
  }

  bool empty() const { return ends_.empty(); }

  /// Calls f(a, b) for each edge once; it returns the number of the middle.
  template <class F>
  void number(const F& f) {
    for (uint32_t a = 0; a + 1 < begin_.size(); ++a) {
      for (uint32_t i = begin_[a]; i < begin_[a + 1]; ++i) {
        uint32_t& middle = ends_[i].middle;
        for (uint32_t j = begin_[a]; j < i && middle == kNone; ++j)
          if (ends_[j].point == ends_[i].point) middle = ends_[j].middle;
        if (middle == kNone) middle = f(a, ends_[i].point);
      }
    }
  }

  uint32_t middle(uint32_t a, uint32_t b) const {
    if (a > b) std::swap(a, b);
    for (uint32_t i = begin_[a]; i < begin_[a + 1]; ++i)
      if (ends_[i].point == b) return ends_[i].middle;
    return kNone;
  }

 private:
  struct End {
    uint32_t point, middle;
  };
  std::vector<uint32_t> begin_;
  std::vector<End> ends_;
};

/// Two to four triangles for one, by which of its edges have a middle.
void split(const std::array<uint32_t, 3>& t, const std::array<uint32_t, 3>& middle, const Surface& surface,
           std::vector<std::array<uint32_t, 3>>& out) {
  const auto count = std::count_if(middle.begin(), middle.end(), [](uint32_t m) { return m != kNone; });
  if (count == 0) {
    out.push_back(t);
    return;
  }
  if (count == 3) {
    for (size_t e = 0; e < 3; ++e) out.push_back({t[e], middle[e], middle[(e + 2) % 3]});
    out.push_back(middle);
    return;
  }
  // Turned so that edge 0 is the one that is split alone, or edge 2 the one that is not.
  size_t turn = 0;
  while (count == 1 ? middle[turn] == kNone : middle[(turn + 2) % 3] != kNone) ++turn;
  const std::array<uint32_t, 3> v{t[turn], t[(turn + 1) % 3], t[(turn + 2) % 3]};
  const uint32_t first = middle[turn];
  if (count == 1) {
    out.push_back({v[0], first, v[2]});
    out.push_back({first, v[1], v[2]});
    return;
  }
  const uint32_t second = middle[(turn + 1) % 3];
  const Vec3 across = surface.points[second] - surface.points[v[0]];
  const Vec3 other = surface.points[v[2]] - surface.points[first];
  out.push_back({first, v[1], second});
  if (dot(across, across) <= dot(other, other)) {
    out.push_back({v[0], first, second});
    out.push_back({v[0], second, v[2]});
  } else {
    out.push_back({v[0], first, v[2]});
    out.push_back({first, second, v[2]});
  }
}

/// a, or b where a has no direction.
Vec3 unit_or(const Vec3& a, const Vec3& b) {
  const double length = norm(a);
  return length > 1e-12 ? a * (1.0 / length) : b;
}

}  // namespace

std::vector<Vec3> vertex_normals(const Surface& surface) {
  std::vector<Vec3> normals(surface.points.size());
  for (const auto& t : surface.triangles) {
    const std::array<Vec3, 3> p{surface.points[t[0]], surface.points[t[1]], surface.points[t[2]]};
    const Vec3 n = unit_or(cross(p[1] - p[0], p[2] - p[0]), {});
    for (size_t i = 0; i < 3; ++i) {
      const Vec3 u = unit_or(p[(i + 1) % 3] - p[i], {}), v = unit_or(p[(i + 2) % 3] - p[i], {});
      normals[t[i]] = normals[t[i]] + n * std::acos(std::clamp(dot(u, v), -1.0, 1.0));
    }
  }
  for (Vec3& n : normals) n = unit_or(n, {0.0, 0.0, 1.0});
  return normals;
}

void refine(Surface& surface, const FacetLimit& limit) {
  // No triangle under the limit is larger than the equilateral one: a lower bound before the work.
  double least = 0.0;
  for (const auto& t : surface.triangles) {
    const Vec3 &a = surface.points[t[0]], &b = surface.points[t[1]], &c = surface.points[t[2]];
    const double longest = limit((a + b + c) * (1.0 / 3.0));
    least += 0.5 * norm(cross(b - a, c - a)) / (0.25 * std::sqrt(3.0) * longest * longest);
  }
  if (!(least <= kMostTriangles)) {
    fail("render", "a body takes over {} triangles at this image size", kMostTriangles);
  }
  std::vector<Vec3> normals;
  for (;;) {
    SplitEdges edges(surface, limit);
    if (edges.empty()) return;
    if (surface.curved && normals.empty()) normals = vertex_normals(surface);
    edges.number([&](uint32_t a, uint32_t b) {
      const Vec3 edge = surface.points[b] - surface.points[a];
      Vec3 middle = (surface.points[a] + surface.points[b]) * 0.5;
      if (surface.curved) {
        const Vec3 from = normals[a], to = normals[b];
        if (dot(from, to) > kSharpest)
          middle = middle + (to * dot(edge, to) - from * dot(edge, from)) * 0.125;
        const Vec3 sum = from + to;
        const double length2 = dot(edge, edge);
        const Vec3 n = length2 > 0.0 ? sum - edge * (dot(sum, edge) / length2) : sum;
        normals.push_back(unit_or(n, from));
      }
      surface.points.push_back(middle);
      return static_cast<uint32_t>(surface.points.size() - 1);
    });
    std::vector<std::array<uint32_t, 3>> triangles;
    triangles.reserve(surface.triangles.size() * 4);
    for (const auto& t : surface.triangles) {
      split(t, {edges.middle(t[0], t[1]), edges.middle(t[1], t[2]), edges.middle(t[2], t[0])}, surface,
            triangles);
    }
    if (static_cast<double>(triangles.size()) > kMostTriangles) {
      fail("render", "a body takes over {} triangles at this image size", kMostTriangles);
    }
    surface.triangles = std::move(triangles);
  }
}

void keep_largest_piece(Surface& surface) {
  std::vector<uint32_t> parent(surface.points.size());
  std::iota(parent.begin(), parent.end(), 0U);
  const auto root = [&parent](uint32_t i) {
    while (parent[i] != i) i = parent[i] = parent[parent[i]];
    return i;
  };
  for (const auto& t : surface.triangles) {
    parent[root(t[1])] = root(t[0]);
    parent[root(t[2])] = root(t[0]);
  }
  std::vector<double> volume(surface.points.size(), 0.0);
  for (const auto& t : surface.triangles) {
    volume[root(t[0])] += dot(surface.points[t[0]], cross(surface.points[t[1]], surface.points[t[2]])) / 6.0;
  }
  const auto best = static_cast<uint32_t>(std::max_element(volume.begin(), volume.end()) - volume.begin());
  std::vector<uint32_t> number(surface.points.size(), kNone);
  std::vector<Vec3> points;
  std::vector<std::array<uint32_t, 3>> triangles;
  for (const auto& t : surface.triangles) {
    if (root(t[0]) != best) continue;
    std::array<uint32_t, 3> kept{};
    for (size_t i = 0; i < 3; ++i) {
      if (number[t[i]] == kNone) {
        number[t[i]] = static_cast<uint32_t>(points.size());
        points.push_back(surface.points[t[i]]);
      }
      kept[i] = number[t[i]];
    }
    triangles.push_back(kept);
  }
  surface.points = std::move(points);
  surface.triangles = std::move(triangles);
}

Mesh to_mesh(const Surface& surface) {
  Mesh mesh;
  mesh.vertices.reserve(surface.points.size());
  for (const Vec3& p : surface.points) {
    mesh.vertices.push_back({static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z)});
  }
  mesh.triangles = surface.triangles;
  remove_degenerate(mesh);
  return mesh;
}

Surface to_surface(const Mesh& mesh) {
  Surface surface;
  surface.points.reserve(mesh.vertices.size());
  for (const auto& v : mesh.vertices) surface.points.push_back({v[0], v[1], v[2]});
  surface.triangles = mesh.triangles;
  return surface;
}

}  // namespace opaline::render
