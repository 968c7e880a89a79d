#include "data/render/fields.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <utility>
#include <vector>

namespace opaline::render {
namespace {

constexpr double kPi = std::numbers::pi;

Vec3 draw_direction(Random& random) {
  return around({0.0, 0.0, 1.0}, random.uniform(-1.0, 1.0), random.uniform(0.0, 2.0 * kPi));
}

/// Minimum, rounded where both are within `width` of each other (quadratic: Quilez, "Smooth minimum", 2013).
/// Where both change by at most the distance, so does it.
double smooth_min(double a, double b, double width) {
  const double h = std::max(width - std::abs(a - b), 0.0);
  return std::min(a, b) - (width > 0.0 ? h * h / (4.0 * width) : 0.0);
}

/// Distances to the shapes of Quilez, "Distance functions" (2008), in a frame of their own.
struct Primitive {
  enum class Kind { kSphere, kBox, kCylinder, kCapsule, kRing };

  Kind kind = Kind::kSphere;
  Vec3 centre;
  Vec3 axes[3] = {{1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
  Vec3 size;           // half-widths; of capsule and ring: length or radius in x
  double round = 0.0;  // radius of edges, limbs and rings

  double distance(const Vec3& point) const {
    const Vec3 d = point - centre;
    const Vec3 p{dot(d, axes[0]), dot(d, axes[1]), dot(d, axes[2])};
    switch (kind) {
      case Kind::kBox: {
        const Vec3 q{std::abs(p.x) - size.x, std::abs(p.y) - size.y, std::abs(p.z) - size.z};
        return outside(q) - round;
      }
      case Kind::kCylinder:
        return outside({std::hypot(p.x, p.y) - size.x, std::abs(p.z) - size.z, -1e3}) - round;
      case Kind::kCapsule:
        return norm({p.x, p.y, p.z - std::clamp(p.z, -size.x, size.x)}) - round;
      case Kind::kRing:
        return std::hypot(std::hypot(p.x, p.y) - size.x, p.z) - round;
      case Kind::kSphere:
        break;
    }
    return norm(p) - size.x;
  }

  /// Distance to a box of which q is the excess over its half-widths.
  static double outside(const Vec3& q) {
    const double within = std::min(std::max({q.x, q.y, q.z}), 0.0);
    return norm({std::max(q.x, 0.0), std::max(q.y, 0.0), std::max(q.z, 0.0)}) + within;
  }

  double reach() const {
    switch (kind) {
      case Kind::kBox:
        return norm(size) + round;
      case Kind::kCylinder:
        return std::hypot(size.x, size.z) + round;
      case Kind::kCapsule:
      case Kind::kRing:
      case Kind::kSphere:
        break;
    }
    return size.x + round;
  }
};

/// A primitive of about this radius around the origin, turned at random.
Primitive draw_primitive(double radius, Random& random) {
  Primitive p;
  p.axes[2] = draw_direction(random);
  const Basis basis = basis_around(p.axes[2]);
  p.axes[0] = basis.first;
  p.axes[1] = basis.second;
  p.kind = static_cast<Primitive::Kind>(random.below(5));
  switch (p.kind) {
    case Primitive::Kind::kSphere:
      p.size.x = radius;
      break;
    case Primitive::Kind::kBox:
      p.size =
          Vec3{random.uniform(0.5, 1.0), random.uniform(0.5, 1.0), random.uniform(0.5, 1.0)} * (0.7 * radius);
      p.round = random.uniform(0.05, 0.3) * radius;
      break;
    case Primitive::Kind::kCylinder:
      p.size = {random.uniform(0.4, 0.8) * radius, 0.0, random.uniform(0.3, 0.9) * radius};
      p.round = random.uniform(0.05, 0.25) * radius;
      break;
    case Primitive::Kind::kCapsule:
      p.size.x = random.uniform(0.6, 1.2) * radius;
      p.round = random.uniform(0.35, 0.6) * radius;
      break;
    case Primitive::Kind::kRing:
      p.size.x = random.uniform(0.8, 1.1) * radius;
      p.round = random.uniform(0.3, 0.45) * radius;
      break;
  }
  return p;
}

/// A capsule from a to b.
Primitive limb(const Vec3& a, const Vec3& b, double radius) {
  Primitive p;
  p.kind = Primitive::Kind::kCapsule;
  p.centre = (a + b) * 0.5;
  const Vec3 way = b - a;
  p.axes[2] = normalised(way);
  const Basis basis = basis_around(p.axes[2]);
  p.axes[0] = basis.first;
  p.axes[1] = basis.second;
  p.size.x = 0.5 * norm(way);
  p.round = radius;
  return p;
}

std::vector<Primitive> draw_heap(Random& random) {
  std::vector<Primitive> parts{draw_primitive(random.uniform(0.45, 0.7), random)};
  const uint32_t more = 1 + random.below(5);
  for (uint32_t i = 0; i < more; ++i) {
    const Primitive& on = parts[random.below(static_cast<uint32_t>(parts.size()))];
    const Vec3 direction = draw_direction(random);
    // Down the ray to the surface of the earlier one, so that the two always meet.
    double low = 0.0, high = on.reach();
    for (int step = 0; step < 20; ++step) {
      const double middle = 0.5 * (low + high);
      (on.distance(on.centre + direction * middle) < 0.0 ? low : high) = middle;
    }
    Primitive next = draw_primitive(random.uniform(0.22, 0.5), random);
    // The hole of a ring is empty: rings meet with their rim.
    const double sink = next.kind == Primitive::Kind::kRing ? next.size.x : 0.0;
    if (on.kind == Primitive::Kind::kRing) low = 0.0;
    next.centre = on.centre + direction * (low + sink);
    if (on.kind == Primitive::Kind::kRing) {
      const Vec3 flat = direction - on.axes[2] * dot(direction, on.axes[2]);
      const double length = norm(flat);
      if (length > 1e-6) next.centre = next.centre + flat * (on.size.x / length);
    }
    parts.push_back(next);
  }
  return parts;
}

std::vector<Primitive> draw_tree(Random& random) {
  struct Tip {
    Vec3 position, direction;
    double radius;
    int depth;
  };
  std::vector<Primitive> parts;
  std::vector<Tip> tips{{{}, draw_direction(random), random.uniform(0.18, 0.3), 0}};
  const auto most = 5 + random.below(7);
  for (size_t at = 0; at < tips.size() && parts.size() < most; ++at) {
    const Tip tip = tips[at];
    const Vec3 end = tip.position + tip.direction * random.uniform(0.3, 0.6);
    parts.push_back(limb(tip.position, end, tip.radius));
    const uint32_t forks = tip.depth < 4 ? 1 + random.below(3) : 0;
    for (uint32_t i = 0; i < forks; ++i) {
      const Vec3 turned = around(tip.direction, random.uniform(0.2, 0.9), random.uniform(0.0, 2.0 * kPi));
      tips.push_back({end, turned, std::max(tip.radius * random.uniform(0.65, 1.0), 0.1), tip.depth + 1});
    }
  }
  return parts;
}

double reach_of(const std::vector<Primitive>& parts) {
  double reach = 0.0;
  for (const Primitive& p : parts) {
    for (const double c : {p.centre.x, p.centre.y, p.centre.z}) {
      reach = std::max(reach, std::abs(c) + p.reach());
    }
  }
  return reach;
}

double thinnest(const std::vector<Primitive>& parts) {
  double least = 1.0;
  for (const Primitive& p : parts) {
    const bool limb = p.kind == Primitive::Kind::kCapsule || p.kind == Primitive::Kind::kRing;
    least = std::min(least, limb ? 2.0 * p.round : p.size.x);
  }
  return least;
}

double united(const std::vector<Primitive>& parts, const Vec3& p, double softness) {
  double sum = parts[0].distance(p);
  for (size_t i = 1; i < parts.size(); ++i) sum = smooth_min(sum, parts[i].distance(p), softness);
  return sum;
}

/// A curve of straight pieces with a radius at each of its points.
class Polyline {
 public:
  struct Point {
    Vec3 position;
    double radius;
  };
  explicit Polyline(std::vector<Point> points) : points_(std::move(points)) {}

  /// To the surface of the tube around it.
  double distance(const Vec3& p) const {
    double best = 1e30;
    for (size_t i = 0; i + 1 < points_.size(); ++i) {
      const Point &a = points_[i], &b = points_[i + 1];
      const Vec3 way = b.position - a.position, from = p - a.position;
      const double length2 = dot(way, way);
      const double t = length2 > 0.0 ? std::clamp(dot(from, way) / length2, 0.0, 1.0) : 0.0;
      const double radius = a.radius + t * (b.radius - a.radius);
      best = std::min(best, norm(from - way * t) - radius);
    }
    return best;
  }

  double reach() const {
    double reach = 0.0;
    for (const Point& p : points_) {
      for (const double c : {p.position.x, p.position.y, p.position.z}) {
        reach = std::max(reach, std::abs(c) + p.radius);
      }
    }
    return reach;
  }
  double thinnest() const {
    double least = 1.0;
    for (const Point& p : points_) least = std::min(least, 2.0 * p.radius);
    return least;
  }

 private:
  std::vector<Point> points_;
};

/// The curve of Catmull and Rom through four values, between the middle two.
double spline(const std::vector<double>& values, double t) {
  const double at = std::clamp(t, 0.0, 1.0) * static_cast<double>(values.size() - 1);
  const auto i = std::min(static_cast<size_t>(at), values.size() - 2);
  const double f = at - static_cast<double>(i);
  const double b = values[i], c = values[i + 1];
  const double a = i > 0 ? values[i - 1] : 2.0 * b - c;
  const double d = i + 2 < values.size() ? values[i + 2] : 2.0 * c - b;
  return b + 0.5 * f * (c - a + f * (2.0 * a - 5.0 * b + 4.0 * c - d + f * (3.0 * (b - c) + d - a)));
}

}  // namespace

ImplicitBody draw_blend(Random& random) {
  const bool tree = random.uniform() < 0.4;
  std::vector<Primitive> parts = tree ? draw_tree(random) : draw_heap(random);
  const double softness = random.uniform(0.05, 0.3);
  const double half = reach_of(parts) + 0.1, thickness = thinnest(parts);
  return {[parts = std::move(parts), softness](const Vec3& p) { return united(parts, p, softness); }, half,
          thickness};
}

ImplicitBody draw_carved(Random& random) {
  std::vector<Primitive> parts{draw_primitive(random.uniform(0.7, 0.9), random)};
  if (parts[0].kind == Primitive::Kind::kRing || parts[0].kind == Primitive::Kind::kCapsule) {
    parts[0].round = 0.5;
  }
  if (random.uniform() < 0.5) {
    parts.push_back(draw_primitive(random.uniform(0.35, 0.6), random));
    parts[1].centre = draw_direction(random) * random.uniform(0.3, 0.6);
  }
  std::vector<Primitive> cuts;
  const uint32_t count = 1 + random.below(3);
  for (uint32_t i = 0; i < count; ++i) {
    Primitive cut = draw_primitive(random.uniform(0.25, 0.55), random);
    const double way = random.uniform();
    if (way < 0.4) {  // right through
      cut = limb({}, cut.axes[2], random.uniform(0.16, 0.32));
      cut.size.x = 3.0;
      cut.centre = draw_direction(random) * random.uniform(0.0, 0.3);
    } else {
      cut.centre = draw_direction(random) * random.uniform(0.55, 0.95);
    }
    cuts.push_back(cut);
  }
  const double softness = random.uniform(0.04, 0.15);
  const double half = reach_of(parts) + 0.1;
  return {[parts = std::move(parts), cuts = std::move(cuts), softness](const Vec3& p) {
            double f = united(parts, p, softness);
            for (const Primitive& cut : cuts) f = -smooth_min(-f, cut.distance(p), softness);
            return f;
          },
          half, 0.12};
}

ImplicitBody draw_tube(Random& random) {
  // A torus knot (turns through the hole, turns around the axis), a plain ring where there are none, or an
  // open spring.
  static constexpr std::array<std::array<int, 2>, 6> kKnots = {
      {{0, 1}, {0, 1}, {0, 1}, {3, 2}, {2, 3}, {5, 2}}};
  const auto kind = random.below(8);
  const double width = random.uniform(0.55, 1.0);  // of what there is room for
  const double swell = random.uniform(0.0, 0.35);
  const int waves = 1 + static_cast<int>(random.below(4));
  const double phase = random.uniform(0.0, 2.0 * kPi);
  std::vector<Polyline::Point> points;
  constexpr int kPieces = 72;
  if (kind < kKnots.size()) {
    const auto [through, around_axis] = kKnots[kind];
    const double minor = through == 0 ? random.uniform(0.0, 0.25) : random.uniform(0.3, 0.38);
    const double room = through == 0 ? 0.38 : through == 5 ? 0.16 : 0.22;
    // A plain ring is bent: out of its plane, and from a circle.
    const double squash = through == 0 ? random.uniform(0.5, 1.0) : 1.0;
    for (int i = 0; i <= kPieces; ++i) {
      const double t = 2.0 * kPi * (i % kPieces) / kPieces;
      const double a = through * t, b = around_axis * t;
      const double r = through == 0 ? 0.8 : 0.7 + minor * std::cos(a);
      const double z = through == 0 ? minor * std::sin(2.0 * t + phase) : minor * std::sin(a);
      const double radius = room * width * (1.0 + swell * std::sin(waves * t + phase)) / (1.0 + swell);
      points.push_back({{r * std::cos(b), squash * r * std::sin(b), z}, std::max(radius, 0.08)});
    }
  } else {
    const double turns = random.uniform(1.5, 3.0), height = random.uniform(0.6, 1.0);
    const double shrink = random.uniform(0.0, 0.5);
    for (int i = 0; i <= kPieces; ++i) {
      const double t = static_cast<double>(i) / kPieces;
      const double r = 0.65 * (1.0 - shrink * t), angle = 2.0 * kPi * turns * t;
      const double radius = std::min(0.2, 0.8 * height / turns) * width *
                            (1.0 + swell * std::sin(waves * kPi * t)) / (1.0 + swell);
      points.push_back(
          {{r * std::cos(angle), r * std::sin(angle), height * (2.0 * t - 1.0)}, std::max(radius, 0.08)});
    }
  }
  Polyline line(std::move(points));
  const double half = line.reach() + 0.1, thickness = line.thinnest();
  return {[line = std::move(line)](const Vec3& p) { return line.distance(p); }, half, thickness};
}

ImplicitBody draw_vessel(Random& random) {
  const double wall = random.uniform(0.045, 0.09);  // half of its thickness
  const double height = random.uniform(0.25, 1.0);
  // Low vessels have few stations: their walls must not fold.
  const size_t stations = 2 + random.below(1 + static_cast<uint32_t>(3.0 * height));
  std::vector<double> radii;
  for (size_t i = 0; i < stations; ++i) radii.push_back(random.uniform(0.3, 0.85));
  if (random.uniform() < 0.4) radii.back() = random.uniform(0.2, 0.35);  // a neck
  // The profile in the plane (radius, height): from the middle of the floor to the rim.
  std::vector<Polyline::Point> profile{{{0.0, -height, 0.0}, wall}};
  constexpr int kPieces = 20;
  for (int i = 0; i <= kPieces; ++i) {
    const double t = static_cast<double>(i) / kPieces;
    profile.push_back({{std::max(spline(radii, t), 0.2), height * (2.0 * t - 1.0), 0.0}, wall});
  }
  const double widest = std::max_element(profile.begin(), profile.end(), [](const auto& a, const auto& b) {
                          return a.position.x < b.position.x;
                        })->position.x;
  const bool handled = random.uniform() < 0.35;
  // An arc that leaves the wall and comes back to it lower down.
  std::vector<Polyline::Point> arc;
  if (handled) {
    const double top = random.uniform(0.65, 0.9), bottom = random.uniform(0.1, 0.4);
    const double out = random.uniform(0.25, 0.5), thick = random.uniform(0.06, 0.1);
    for (int i = 0; i <= 12; ++i) {
      const double s = static_cast<double>(i) / 12.0, t = top + s * (bottom - top);
      const double r = std::max(spline(radii, t), 0.2) + out * std::sin(kPi * s);
      arc.push_back({{r, height * (2.0 * t - 1.0), 0.0}, thick});
    }
  }
  const double half = std::max(height, widest + (handled ? 0.5 : 0.0)) + 0.2;
  const double softness = random.uniform(0.05, 0.12);
  return {[line = Polyline(std::move(profile)), handle = Polyline(std::move(arc)), handled,
           softness](const Vec3& p) {
            const double body = line.distance({std::hypot(p.x, p.z), p.y, 0.0});
            return handled ? smooth_min(body, handle.distance(p), softness) : body;
          },
          half, 2.0 * wall};
}

}  // namespace opaline::render
