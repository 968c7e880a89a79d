#include "data/render/sights.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "core/error.h"
#include "data/render/fresnel.h"

namespace opaline::render {
namespace {

/// By how much of a facet its beam is taken wider than its middle says: rays are not quite parallel, and
/// neither do they diverge quite evenly.
constexpr double kMargin = 0.05;
/// Cells are about so wide as so many facets, and at most so many along a side.
constexpr double kFacetsPerCell = 2.0;
constexpr double kMostCells = 96.0;

double component(const Vec3& v, size_t axis) {
  return axis == 0 ? v.x : (axis == 1 ? v.y : v.z);
}

/// The bits of three numbers in [0, 1], interleaved: close keys are close points.
uint64_t morton(const Vec3& p) {
  const auto spread = [](double value) {
    auto bits = static_cast<uint64_t>(std::clamp(value, 0.0, 1.0) * 0x1FFFFF);
    bits = (bits | bits << 32) & 0x001F00000000FFFFU;
    bits = (bits | bits << 16) & 0x001F0000FF0000FFU;
    bits = (bits | bits << 8) & 0x100F00F00F00F00FU;
    bits = (bits | bits << 4) & 0x10C30C30C30C30C3U;
    return (bits | bits << 2) & 0x1249249249249249U;
  };
  return spread(p.x) | spread(p.y) << 1 | spread(p.z) << 2;
}

}  // namespace

Sights::Sights(const Mesh& mesh, const Camera& camera, double index, const Vec3& low, const Vec3& high)
    : camera_(camera), index_(index), scale_(camera.pixel_size(camera.position.z - 1.0)), low_(low) {
  if (!(camera.position.z > high.z)) {
    fail_usage("render", "a camera at height {} is not above the body, which ends at {}", camera.position.z,
               high.z);
  }
  const Vec3 size = high - low;
  const double largest = std::max({size.x, size.y, size.z});
  std::vector<Corners> facing;
  std::vector<std::pair<uint64_t, uint32_t>> order;
  double area = 0.0;
  for (const auto& triangle : mesh.triangles) {
    Corners p;
    for (size_t i = 0; i < 3; ++i) {
      const auto& v = mesh.vertices[triangle[i]];
      p[i] = {v[0], v[1], v[2]};
    }
    const Vec3 n = cross(p[1] - p[0], p[2] - p[0]);
    if (!(dot(camera.position - p[0], n) > 0.0)) continue;
    area += 0.5 * norm(n);
    order.emplace_back(morton((p[0] - low) * (1.0 / largest)), static_cast<uint32_t>(facing.size()));
    facing.push_back(p);
  }
  std::sort(order.begin(), order.end());

  std::vector<Corners> corners;
  corners.reserve(order.size());
  facets_.reserve(order.size());
  bundles_.resize((order.size() + kBundle - 1) / kBundle);
  // Lanes without a facet: nothing passes.
  for (Bundle& bundle : bundles_) bundle.u[3].fill(-1.0F);
  const double rounding = 1e-6 * std::max({norm(low), norm(high), largest});
  for (const auto& [key, number] : order) {
    corners.push_back(facing[number]);
    add_facet(facing[number], facets_.size(), rounding);
  }

  const double facet = std::sqrt(area / std::max(1.0, static_cast<double>(facets_.size())));
  const double side = std::max(kFacetsPerCell * facet, largest / kMostCells);
  for (size_t axis = 0; axis < 3; ++axis) {
    cells_[axis] = std::max<int64_t>(1, static_cast<int64_t>(std::ceil(component(size, axis) / side)));
  }
  cell_ = {side, side, side};

  const auto count = static_cast<size_t>(cells_[0] * cells_[1] * cells_[2]);
  const auto for_each_bundle = [&](const auto& f) {
    for (size_t i = 0; i < bundles_.size(); ++i) {
      const size_t first = i * kBundle, n = std::min(kBundle, facets_.size() - first);
      for_each_cell(std::span(facets_).subspan(first, n), std::span<const Corners>(corners).subspan(first, n),
                    [&](size_t cell, double length) { f(i, cell, length); });
    }
  };
  starts_.assign(count + 1, 0);
  shortest_.assign(count, HUGE_VALF);
  for_each_bundle([&](size_t, size_t cell, double length) {
    ++starts_[cell + 1];
    shortest_[cell] = std::min(shortest_[cell], static_cast<float>(length));
  });
  for (size_t i = 0; i < count; ++i) starts_[i + 1] += starts_[i];
  entries_.resize(starts_.back());
  std::vector<uint32_t> next(starts_.begin(), starts_.end() - 1);
  for_each_bundle(
      [&](size_t bundle, size_t cell, double) { entries_[next[cell]++] = static_cast<uint32_t>(bundle); });
}

void Sights::add_facet(const Corners& p, size_t number, double rounding) {
  const Vec3 ab = p[1] - p[0], ac = p[2] - p[0], n = cross(ab, ac);
  const double twice = norm(n);
  // Gradients within the plane: u (v) is 1 at the second (third) corner and 0 at the others.
  const Facet facet{.corner = p[0],
                    .normal = n * (1.0 / twice),
                    .u = cross(ac, n) * (1.0 / (twice * twice)),
                    .v = cross(n, ab) * (1.0 / (twice * twice))};
  const Vec3 middle = (p[0] + p[1] + p[2]) * (1.0 / 3.0);
  const Vec3 inside = refracted(middle, facet.normal);
  const double cosine = -dot(inside, facet.normal), distance = norm(middle - camera_.position);

  Bundle& bundle = bundles_[number / kBundle];
  const size_t lane = number % kBundle;
  const auto set = [lane, &p](std::array<Lanes, 4>& functional, const Vec3& gradient) {
    functional[0][lane] = static_cast<float>(gradient.x);
    functional[1][lane] = static_cast<float>(gradient.y);
    functional[2][lane] = static_cast<float>(gradient.z);
    functional[3][lane] = static_cast<float>(-dot(gradient, p[0]));
  };
  // Back along `inside` to the plane: point - inside depth / cosine, downwards positive.
  set(bundle.depth, -facet.normal);
  set(bundle.u, facet.u + facet.normal * (dot(facet.u, inside) / cosine));
  set(bundle.v, facet.v + facet.normal * (dot(facet.v, inside) / cosine));
  bundle.margin[lane] = static_cast<float>(kMargin + rounding * std::max(norm(facet.u), norm(facet.v)));
  bundle.widening[lane] = static_cast<float>((1.0 + kMargin) / (3.0 * index_ * distance * cosine));
  facets_.push_back(facet);
}

/// Where the camera's ray to a point of the surface goes on inside.
Vec3 Sights::refracted(const Vec3& surface, const Vec3& normal) const {
  const Vec3 direction = normalised(surface - camera_.position);
  const double cosine = -dot(direction, normal);
  const double behind = std::sqrt(1.0 - (1.0 - cosine * cosine) / (index_ * index_));
  return normalised(direction * (1.0 / index_) + normal * (cosine / index_ - behind));
}

/// Calls f(cell, length) for the cells that the facets' beams may pass, layer by layer down from the facets;
/// `length` is a lower bound of the way there.
template <class F>
void Sights::for_each_cell(std::span<const Facet> facets, std::span<const Corners> corners,
                           const F& f) const {
  struct Edge {
    Vec3 start;   // at height 0
    double x, y;  // by height
  };
  std::array<Edge, 3 * kBundle> edges;
  size_t count = 0;
  double top = -HUGE_VAL, bottom = HUGE_VAL, margin = 0.0;
  for (size_t k = 0; k < facets.size(); ++k) {
    for (const Vec3& corner : corners[k]) {
      const Vec3 inside = refracted(corner, facets[k].normal);
      const double x = inside.x / inside.z, y = inside.y / inside.z;
      edges[count++] = {{corner.x - x * corner.z, corner.y - y * corner.z, 0.0}, x, y};
      top = std::max(top, corner.z);
      bottom = std::min(bottom, corner.z);
      margin = std::max(margin, kMargin * norm(corner - corners[k][0]));
    }
  }
  struct Box {
    double x0 = HUGE_VAL, x1 = -HUGE_VAL, y0 = HUGE_VAL, y1 = -HUGE_VAL;
  };
  // The beams' cross-section at a height, continued above the facets.
  const auto section = [&](double z) {
    Box box;
    for (size_t i = 0; i < count; ++i) {
      const double x = edges[i].start.x + edges[i].x * z, y = edges[i].start.y + edges[i].y * z;
      box.x0 = std::min(box.x0, x), box.x1 = std::max(box.x1, x);
      box.y0 = std::min(box.y0, y), box.y1 = std::max(box.y1, y);
    }
    return box;
  };
  const auto clamped = [this](double x, size_t axis) {
    return std::clamp(static_cast<int64_t>(std::floor(x)), int64_t{0}, cells_[axis] - 1);
  };
  Box above = section(top);
  double ceiling = top;
  for (int64_t k = clamped((top - low_.z) / cell_.z, 2); k >= 0; --k) {
    const double floor = low_.z + static_cast<double>(k) * cell_.z;
    const Box below = section(floor);
    const double x0 = (std::min(above.x0, below.x0) - margin - low_.x) / cell_.x;
    const double x1 = (std::max(above.x1, below.x1) + margin - low_.x) / cell_.x;
    const double y0 = (std::min(above.y0, below.y0) - margin - low_.y) / cell_.y;
    const double y1 = (std::max(above.y1, below.y1) + margin - low_.y) / cell_.y;
    const double length = std::max(0.0, bottom - ceiling);
    above = below;
    ceiling = floor;
    // Points of the body lie in the box.
    if (x1 < 0.0 || y1 < 0.0 || x0 >= static_cast<double>(cells_[0]) ||
        y0 >= static_cast<double>(cells_[1])) {
      continue;
    }
    const int64_t i0 = clamped(x0, 0), i1 = clamped(x1, 0), j1 = clamped(y1, 1);
    for (int64_t j = clamped(y0, 1); j <= j1; ++j) {
      for (int64_t i = i0; i <= i1; ++i) {
        f(static_cast<size_t>((k * cells_[1] + j) * cells_[0] + i), length);
      }
    }
  }
}

size_t Sights::cell(const Vec3& point) const {
  const Vec3 p = point - low_;
  const auto index = [this](double x, size_t axis) {
    return std::clamp(static_cast<int64_t>(x), int64_t{0}, cells_[axis] - 1);
  };
  return static_cast<size_t>((index(p.z / cell_.z, 2) * cells_[1] + index(p.y / cell_.y, 1)) * cells_[0] +
                             index(p.x / cell_.x, 0));
}

uint32_t Sights::may_pass(const Bundle& bundle, const Vec3& point) {
  const auto x = static_cast<float>(point.x), y = static_cast<float>(point.y),
             z = static_cast<float>(point.z);
  Lanes within;  // by how much of a facet
  for (size_t i = 0; i < kBundle; ++i) {
    const auto linear = [&](const std::array<Lanes, 4>& f) {
      return f[0][i] * x + f[1][i] * y + f[2][i] * z + f[3][i];
    };
    const float u = linear(bundle.u), v = linear(bundle.v), depth = linear(bundle.depth);
    const float least = std::min(std::min(u, v), 1.0F - u - v);
    within[i] = least + bundle.margin[i] + bundle.widening[i] * std::max(depth, 0.0F);
  }
  uint32_t negative = 0;
  for (size_t i = 0; i < kBundle; ++i) negative |= std::bit_cast<uint32_t>(within[i]) >> 31U << i;
  return ~negative & ((1U << kBundle) - 1U);
}

bool Sights::find(const Facet& facet, const Vec3& point, Sight& sight) const {
  const double depth = dot(facet.corner - point, facet.normal);
  if (!(depth > 0.0)) return false;
  const double height = dot(camera_.position - facet.corner, facet.normal);
  const Vec3 foot = camera_.position - facet.normal * height;
  const Vec3 across = point + facet.normal * depth - foot;
  const double distance = norm(across);
  // The tangent q of the angle outside: height q + depth q / root(n^2 + (n^2 - 1) q^2) = distance (Snell).
  // The left side is concave in q, so Newton's steps from below approach the root from below.
  const double n2 = index_ * index_;
  double q = distance / (height + depth / index_);
  for (int step = 0; step < 50; ++step) {
    const double square = n2 + (n2 - 1.0) * q * q, root = std::sqrt(square);
    const double change = (distance - q * (height + depth / root)) / (height + depth * n2 / (square * root));
    q += change;
    if (!(std::abs(change) > 1e-15 * q)) break;
  }
  const Vec3 surface = distance > 0.0 ? foot + across * (height * q / distance) : foot;
  const double u = dot(surface - facet.corner, facet.u), v = dot(surface - facet.corner, facet.v);
  if (!(u >= 0.0 && v >= 0.0 && u + v <= 1.0)) return false;

  const Vec3 from = surface - camera_.position;
  const double below = -from.z;
  sight.x = from.x / (below * scale_) + 0.5 * camera_.width;
  sight.y = 0.5 * camera_.height - from.y / (below * scale_);
  if (!(sight.x >= 0.0 && sight.x < camera_.width && sight.y >= 0.0 && sight.y < camera_.height))
    return false;
  const double outside = norm(from);
  sight.surface = surface;
  sight.normal = facet.normal;
  sight.direction = from * (1.0 / outside);
  sight.cosine = 1.0 / std::sqrt(1.0 + q * q);
  const double behind = std::sqrt(1.0 - (1.0 - sight.cosine * sight.cosine) / n2);
  sight.length = depth / behind;
  sight.inside =
      normalised(sight.direction * (1.0 / index_) + sight.normal * (sight.cosine / index_ - behind));
  // Widths of the beam of an angle across and along the plane of incidence: the angle refracts to
  // d theta' = d theta cos / (n cos'), and the facet is met obliquely.
  const double sagittal = outside + sight.length / index_;
  const double meridional = outside * behind / sight.cosine + sight.length * sight.cosine / (index_ * behind);
  const double steep = below / outside;  // cosine at which the pixel is seen
  sight.section = sagittal * meridional * scale_ * scale_ * steep * steep * steep;
  return true;
}

}  // namespace opaline::render
