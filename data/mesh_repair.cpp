#include "data/mesh_repair.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <map>
#include <numbers>
#include <utility>
#include <vector>

#include "core/error.h"
#include "core/random.h"
#include "data/render/geometry.h"

namespace opaline {
namespace {

using render::Hit;
using render::Surface;
using render::Vec3;
using Triangle = std::array<uint32_t, 3>;

constexpr uint32_t kNone = UINT32_MAX;
constexpr size_t kMostPieces = 64;
constexpr size_t kMostHoleEdges = 64;
constexpr double kLongestHole = 0.1;  // border / radius of the body
constexpr int kRays = 2000;

/// Into the unit ball around the origin.
void fit(Surface& surface, const std::string& name) {
  std::array<double, 3> low{1e30, 1e30, 1e30}, high{-1e30, -1e30, -1e30};
  for (const Triangle& t : surface.triangles) {
    for (const uint32_t i : t) {
      const std::array<double, 3> p{surface.points[i].x, surface.points[i].y, surface.points[i].z};
      for (size_t a = 0; a < 3; ++a) {
        low[a] = std::min(low[a], p[a]);
        high[a] = std::max(high[a], p[a]);
      }
    }
  }
  const Vec3 centre{0.5 * (low[0] + high[0]), 0.5 * (low[1] + high[1]), 0.5 * (low[2] + high[2])};
  const double radius = 0.5 * std::hypot(high[0] - low[0], high[1] - low[1], high[2] - low[2]);
  if (!(radius > 0.0)) fail(name, "has no size");
  for (Vec3& p : surface.points) p = (p - centre) * (1.0 / radius);
}

/// Merges points within a cell of a millionth; drops triangles that vanish or are there twice.
void weld(Surface& surface, MeshRepair& repair) {
  std::map<std::array<int64_t, 3>, uint32_t> cells;
  std::vector<uint32_t> number(surface.points.size(), kNone);
  std::vector<Vec3> points;
  std::vector<Triangle> triangles;
  for (Triangle t : surface.triangles) {
    for (uint32_t& v : t) {
      if (number[v] == kNone) {
        const Vec3 p = surface.points[v];
        const std::array<int64_t, 3> cell{std::llround(p.x * 1e6), std::llround(p.y * 1e6),
                                          std::llround(p.z * 1e6)};
        const auto [found, fresh] = cells.try_emplace(cell, static_cast<uint32_t>(points.size()));
        if (fresh) {
          points.push_back(p);
        } else {
          ++repair.merged;
        }
        number[v] = found->second;
      }
      v = number[v];
    }
    if (t[0] == t[1] || t[1] == t[2] || t[2] == t[0]) {
      ++repair.dropped;
      continue;
    }
    std::rotate(t.begin(), std::min_element(t.begin(), t.end()), t.end());
    triangles.push_back(t);
  }
  std::sort(triangles.begin(), triangles.end());
  const auto end = std::unique(triangles.begin(), triangles.end());
  repair.dropped += triangles.end() - end;
  triangles.erase(end, triangles.end());
  surface.points = std::move(points);
  surface.triangles = std::move(triangles);
}

/// The triangles at each side of each triangle; kNone at a border. More than two at an edge are an error.
std::vector<Triangle> neighbours(const Surface& surface, const std::string& name) {
  struct Side {
    uint32_t a, b, triangle, edge;
    auto key() const { return std::pair(a, b); }
  };
  std::vector<Side> sides;
  sides.reserve(3 * surface.triangles.size());
  for (uint32_t i = 0; i < surface.triangles.size(); ++i) {
    for (uint32_t e = 0; e < 3; ++e) {
      const uint32_t a = surface.triangles[i][e], b = surface.triangles[i][(e + 1) % 3];
      sides.push_back({std::min(a, b), std::max(a, b), i, e});
    }
  }
  std::sort(sides.begin(), sides.end(), [](const Side& x, const Side& y) {
    return std::pair(x.key(), x.triangle) < std::pair(y.key(), y.triangle);
  });
  std::vector<Triangle> result(surface.triangles.size(), {kNone, kNone, kNone});
  for (size_t i = 0; i < sides.size();) {
    size_t end = i + 1;
    while (end < sides.size() && sides[end].key() == sides[i].key()) ++end;
    if (end - i > 2) fail(name, "is not a surface: {} triangles share an edge", end - i);
    if (end - i == 2) {
      result[sides[i].triangle][sides[i].edge] = sides[i + 1].triangle;
      result[sides[i + 1].triangle][sides[i + 1].edge] = sides[i].triangle;
    }
    i = end;
  }
  return result;
}

bool has_edge(const Triangle& t, uint32_t a, uint32_t b) {
  for (size_t e = 0; e < 3; ++e)
    if (t[e] == a && t[(e + 1) % 3] == b) return true;
  return false;
}

/// Turns all triangles of a connected piece the way of its first. Returns the number of each one's piece.
std::vector<uint32_t> orient(Surface& surface, const std::string& name, MeshRepair& repair) {
  const std::vector<Triangle> next = neighbours(surface, name);
  std::vector<uint32_t> piece(surface.triangles.size(), kNone);
  uint32_t pieces = 0;
  std::vector<uint32_t> open;
  // Sides of a triangle that is turned change places; neighbours are looked up in its first form.
  const std::vector<Triangle> before = surface.triangles;
  for (uint32_t start = 0; start < piece.size(); ++start) {
    if (piece[start] != kNone) continue;
    piece[start] = pieces;
    open.push_back(start);
    while (!open.empty()) {
      const uint32_t i = open.back();
      open.pop_back();
      for (size_t e = 0; e < 3; ++e) {
        const uint32_t j = next[i][e];
        if (j == kNone) continue;
        uint32_t a = before[i][e], b = before[i][(e + 1) % 3];
        if (!has_edge(surface.triangles[i], a, b)) std::swap(a, b);
        const bool same = has_edge(surface.triangles[j], b, a);
        if (piece[j] == kNone) {
          if (!same) {
            std::swap(surface.triangles[j][1], surface.triangles[j][2]);
            ++repair.turned;
          }
          piece[j] = pieces;
          open.push_back(j);
        } else if (!same) {
          fail(name, "has no inside: it turns into its other side, like a Moebius strip");
        }
      }
    }
    ++pieces;
  }
  return piece;
}

/// Closes short borders. Triangles of one piece must face the same way.
void fill_holes(Surface& surface, const std::string& name, MeshRepair& repair) {
  // The border runs against the triangles: from the end of an edge without a neighbour to its start.
  const std::vector<Triangle> next = neighbours(surface, name);
  std::map<uint32_t, uint32_t> border;
  for (size_t i = 0; i < next.size(); ++i) {
    for (size_t e = 0; e < 3; ++e) {
      if (next[i][e] != kNone) continue;
      const uint32_t from = surface.triangles[i][(e + 1) % 3], to = surface.triangles[i][e];
      if (!border.try_emplace(from, to).second) fail(name, "is not closed: two holes meet in a point");
    }
  }
  while (!border.empty()) {
    std::vector<uint32_t> loop{border.begin()->first};
    double around = 0.0;
    Vec3 middle{};
    for (;;) {
      const auto edge = border.find(loop.back());
      if (edge == border.end()) fail(name, "is not closed: a border has no end");
      const uint32_t to = edge->second;
      around += norm(surface.points[to] - surface.points[loop.back()]);
      middle = middle + surface.points[to];
      border.erase(edge);
      if (to == loop.front()) break;
      loop.push_back(to);
    }
    if (loop.size() > kMostHoleEdges || !(around <= kLongestHole)) {
      fail(name, "is not closed: a hole of {} edges, {:.3g} of its radius around", loop.size(), around);
    }
    ++repair.filled;
    if (loop.size() == 3) {
      surface.triangles.push_back({loop[0], loop[1], loop[2]});
      continue;
    }
    const auto centre = static_cast<uint32_t>(surface.points.size());
    surface.points.push_back(middle * (1.0 / static_cast<double>(loop.size())));
    for (size_t i = 0; i < loop.size(); ++i)
      surface.triangles.push_back({loop[i], loop[(i + 1) % loop.size()], centre});
  }
}

/// Whether the ray passes through the triangle (Moeller and Trumbore 1997).
bool passes(const Surface& surface, const Triangle& t, const Vec3& origin, const Vec3& direction) {
  const Vec3 a = surface.points[t[0]], ab = surface.points[t[1]] - a, ac = surface.points[t[2]] - a;
  const Vec3 p = cross(direction, ac);
  const double determinant = dot(ab, p);
  if (!(std::abs(determinant) > 0.0)) return false;
  const Vec3 way = origin - a, q = cross(way, ab);
  const double u = dot(way, p) / determinant, v = dot(direction, q) / determinant;
  return u >= 0.0 && v >= 0.0 && u + v <= 1.0 && dot(ac, q) / determinant > 0.0;
}

/// Turns pieces outwards, those inside an odd number of others inwards.
void turn_pieces(Surface& surface, const std::vector<uint32_t>& piece, const std::string& name,
                 MeshRepair& repair) {
  const size_t pieces = piece.empty() ? 0 : *std::max_element(piece.begin(), piece.end()) + size_t{1};
  if (pieces > kMostPieces) fail(name, "consists of {} pieces; at most {} are sorted", pieces, kMostPieces);
  std::vector<double> volume(pieces, 0.0);
  std::vector<Vec3> sample(pieces);
  for (size_t i = 0; i < piece.size(); ++i) {
    const Triangle& t = surface.triangles[i];
    volume[piece[i]] += dot(surface.points[t[0]], cross(surface.points[t[1]], surface.points[t[2]])) / 6.0;
    sample[piece[i]] = (surface.points[t[0]] + surface.points[t[1]] + surface.points[t[2]]) * (1.0 / 3.0);
  }
  const Vec3 direction = render::normalised({0.8017, 0.2673, 0.5345});  // along no axis or diagonal
  std::vector<bool> turn(pieces);
  for (size_t k = 0; k < pieces; ++k) {
    std::vector<bool> inside(pieces, false);
    for (size_t i = 0; pieces > 1 && i < piece.size(); ++i) {
      if (piece[i] != k && passes(surface, surface.triangles[i], sample[k], direction)) {
        inside[piece[i]] = !inside[piece[i]];
      }
    }
    const bool cavity = std::count(inside.begin(), inside.end(), true) % 2 == 1;
    if (cavity) ++repair.cavities;
    turn[k] = (volume[k] < 0.0) != cavity;
  }
  for (size_t i = 0; i < piece.size(); ++i) {
    if (!turn[piece[i]]) continue;
    std::swap(surface.triangles[i][1], surface.triangles[i][2]);
    ++repair.turned;
  }
}

Vec3 draw_direction(Random& random) {
  const double cosine = random.uniform(-1.0, 1.0), azimuth = random.uniform(0.0, 2.0 * std::numbers::pi);
  return render::around({0.0, 0.0, 1.0}, cosine, azimuth);
}

/// Sends rays through the body: along each, entries and exits must alternate. Returns the wall that 1 in 20
/// inward rays find thinner.
double probe(const render::Mesh& mesh, const std::string& name) {
  if (const std::string leak = describe_leak(mesh); !leak.empty()) fail(name, "is not closed: {}", leak);
  if (!(enclosed_volume(mesh) > 1e-6)) fail(name, "encloses no volume, or its pieces intersect each other");
  const auto geometry = render::make_mesh_geometry(mesh);
  Random random(0, Purpose::kScene);
  int wrong = 0;
  std::vector<double> walls;
  for (int i = 0; i < kRays; ++i) {
    Vec3 origin = draw_direction(random) * 1.5;
    const Vec3 direction = normalised(draw_direction(random) * random.uniform() - origin);
    Hit hit;
    bool inside = false;
    double entry = 0.0, way = 0.0;
    while (geometry->intersect(origin, direction, render::kInfinity, hit)) {
      way += hit.distance;
      if ((dot(direction, hit.normal) > 0.0) != inside) break;
      if (inside) walls.push_back(way - entry);
      entry = way;
      inside = !inside;
      origin = geometry->leave(hit, direction);
      hit = {};
    }
    if (inside || hit.distance > 0.0) ++wrong;
  }
  if (wrong > kRays / 200) {
    fail(name, "intersects itself: {} of {} rays meet it from a wrong side", wrong, kRays);
  }
  if (walls.size() < 20) return 0.0;
  const auto quantile = walls.begin() + static_cast<std::ptrdiff_t>(walls.size() / 20);
  std::nth_element(walls.begin(), quantile, walls.end());
  return *quantile;
}

}  // namespace

MeshRepair repair_mesh(Surface& surface, const std::string& name) {
  MeshRepair repair;
  if (surface.triangles.empty()) fail(name, "has no faces");
  fit(surface, name);
  weld(surface, repair);
  if (surface.triangles.empty()) fail(name, "has no faces with area");
  orient(surface, name, repair);
  fill_holes(surface, name, repair);
  const std::vector<uint32_t> piece = orient(surface, name, repair);
  turn_pieces(surface, piece, name, repair);
  const render::Mesh mesh = to_mesh(surface);  // without slivers
  const double thickness = probe(mesh, name);
  surface = render::to_surface(mesh);
  surface.curved = false;
  surface.thickness = thickness;
  return repair;
}

}  // namespace opaline
