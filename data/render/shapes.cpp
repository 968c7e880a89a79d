#include "data/render/shapes.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <vector>

#include "data/render/noise.h"

namespace opaline::render {
namespace {

constexpr double kPi = std::numbers::pi;

/// From a direction to the body's surface.
using Body = std::function<Vec3(const Vec3&)>;

uint32_t draw_key(Random& random) {
  return random.bits();
}

double log_uniform(double low, double high, Random& random) {
  return low * std::pow(high / low, random.uniform());
}

Body harmonics_body(Random& random) {
  const uint32_t key = draw_key(random);
  const double height = random.uniform(0.15, 0.55), frequency = random.uniform(0.8, 1.8);
  const Vec3 axes{random.uniform(0.6, 1.0), random.uniform(0.6, 1.0), random.uniform(0.6, 1.0)};
  return [=](const Vec3& d) {
    const double r = 1.0 + height * fractal_noise(d * frequency + Vec3{7.5, 3.5, 5.5}, key, 2);
    return Vec3{d.x * axes.x * r, d.y * axes.y * r, d.z * axes.z * r};
  };
}

/// |x|^(2/e) with the sign dropped.
double power(double x, double e) {
  return std::pow(std::abs(x), 2.0 / e);
}

struct Superquadric {
  Vec3 axes;
  double east, north;

  /// Radius along d: the inside-outside function is homogeneous of degree 2 / north.
  double radius(const Vec3& d) const {
    const double round = power(d.x / axes.x, east) + power(d.y / axes.y, east);
    const double f = std::pow(round, east / north) + power(d.z / axes.z, north);
    return std::pow(f, -0.5 * north);
  }
};

Superquadric draw_superquadric(Random& random) {
  const Vec3 axes{random.uniform(0.5, 1.0), random.uniform(0.5, 1.0), random.uniform(0.5, 1.0)};
  const double east = random.uniform(0.25, 1.5), north = random.uniform(0.25, 1.5);
  return {axes, east, north};
}

Body superquadric_body(Random& random) {
  const Superquadric body = draw_superquadric(random);
  return [body](const Vec3& d) { return d * body.radius(d); };
}

Body twisted_body(Random& random) {
  const Superquadric body = draw_superquadric(random);
  const double twist = random.uniform(-2.0, 2.0), taper = random.uniform(-0.5, 0.5);
  const double waist = random.uniform(-0.3, 0.3);
  return [=](const Vec3& d) {
    const Vec3 p = d * body.radius(d);
    const double t = p.z / body.axes.z;
    const double width = 1.0 + taper * t + waist * (t * t - 0.5);
    const double c = std::cos(twist * t), s = std::sin(twist * t);
    return Vec3{width * (c * p.x - s * p.y), width * (s * p.x + c * p.y), p.z};
  };
}

Body blend_body(Random& random) {
  struct Ball {
    Vec3 centre;
    double radius;
  };
  std::vector<Ball> balls;
  const int64_t count = 3 + random.below(5);
  for (int64_t i = 0; i < count; ++i) {
    const double z = random.uniform(-1.0, 1.0), angle = random.uniform(0.0, 2.0 * kPi);
    const double s = std::sqrt(1.0 - z * z), distance = random.uniform(0.2, 0.75);
    balls.push_back({Vec3{s * std::cos(angle), s * std::sin(angle), z} * distance, random.uniform(0.2, 0.5)});
  }
  balls.push_back({{}, random.uniform(0.35, 0.6)});
  const double softness = log_uniform(0.03, 0.15, random);
  // The smooth minimum of the distances to the balls (softmin), zero on the surface. A ball that the origin
  // is not in is reached through a neck: distances are measured to the segment from the origin to its centre.
  const auto outside = [balls, softness](const Vec3& p) {
    double sum = 0.0;
    for (const Ball& ball : balls) {
      const double length2 = dot(ball.centre, ball.centre);
      const double along = length2 > 0.0 ? std::clamp(dot(p, ball.centre) / length2, 0.0, 1.0) : 0.0;
      const double width = ball.radius * (0.45 + 0.55 * along);
      sum += std::exp(-(norm(p - ball.centre * along) - width) / softness);
    }
    return -softness * std::log(sum);
  };
  // Every limb is a cone around a ray from the origin, so rays leave the body once: bisection finds where.
  return [outside](const Vec3& d) {
    double low = 0.0, high = 3.0;
    for (int i = 0; i < 40; ++i) {
      const double middle = 0.5 * (low + high);
      (outside(d * middle) < 0.0 ? low : high) = middle;
    }
    return d * low;
  };
}

Body draw_body(Family family, Random& random) {
  switch (family) {
    case Family::kSuperquadric:
      return superquadric_body(random);
    case Family::kBlend:
      return blend_body(random);
    case Family::kTwisted:
      return twisted_body(random);
    case Family::kHarmonics:
      break;
  }
  return harmonics_body(random);
}

struct Rotation {
  Vec3 rows[3];
  Vec3 operator()(const Vec3& p) const { return {dot(rows[0], p), dot(rows[1], p), dot(rows[2], p)}; }
};

/// Uniform over all rotations: a uniform axis for z, a uniform angle around it.
Rotation draw_rotation(Random& random) {
  const double z = random.uniform(-1.0, 1.0), angle = random.uniform(0.0, 2.0 * kPi);
  const double s = std::sqrt(1.0 - z * z), turn = random.uniform(0.0, 2.0 * kPi);
  const Vec3 w{s * std::cos(angle), s * std::sin(angle), z};
  const Basis basis = basis_around(w);
  const Vec3 u = basis.first * std::cos(turn) + basis.second * std::sin(turn);
  return {{u, cross(w, u), w}};
}

}  // namespace

Mesh make_shape(const ShapeOptions& options, Random& random) {
  const Body body = draw_body(options.family, random);
  const Rotation rotation = draw_rotation(random);
  const uint32_t key = draw_key(random);
  const double frequency = log_uniform(3.0, 12.0, random);
  const bool bumpy = random.uniform() < 0.7;
  // Two octaves of noise at this frequency have gradients up to about 2.5 x frequency.
  const double height = bumpy ? options.bump * random.uniform() / (2.5 * frequency) : 0.0;

  Mesh mesh = cube_sphere(options.sides);
  std::vector<Vec3> points;
  points.reserve(mesh.vertices.size());
  Vec3 low{1e30, 1e30, 1e30}, high{-1e30, -1e30, -1e30};
  for (const auto& v : mesh.vertices) {
    const Vec3 d = normalised({v[0], v[1], v[2]});
    Vec3 p = body(d);
    if (height > 0.0) p = p * (1.0 + height * fractal_noise(p * frequency, key, 2) / std::max(norm(p), 0.2));
    p = rotation(p);
    points.push_back(p);
    low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
    high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
  }
  const Vec3 centre = (low + high) * 0.5;
  double largest2 = 0.0;
  for (const Vec3& p : points) largest2 = std::max(largest2, dot(p - centre, p - centre));
  const double scale = options.radius / std::sqrt(largest2);
  for (size_t i = 0; i < points.size(); ++i) {
    const Vec3 p = (points[i] - centre) * scale;
    mesh.vertices[i] = {static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z)};
  }
  return mesh;
}

}  // namespace opaline::render
