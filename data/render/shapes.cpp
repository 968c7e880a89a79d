#include "data/render/shapes.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <numbers>
#include <vector>

#include "core/error.h"
#include "data/render/fields.h"
#include "data/render/noise.h"

namespace opaline::render {
namespace {

constexpr double kPi = std::numbers::pi;
/// Quads along an edge of the cube that spheres are made from, and cells along an implicit body's grid:
/// enough for every family's detail, whatever the camera.
constexpr int kSides = 80;
constexpr int kFewestCells = 64, kMostCells = 96;

/// From a direction to the body's surface.
using Map = std::function<Vec3(const Vec3&)>;

/// |x|^(2/e) with the sign dropped.
double power(double x, double e) {
  return std::pow(std::abs(x), 2.0 / e);
}

struct Superquadric {
  Vec3 axes;
  double east, north;

  /// The surface's point in the direction of the ellipsoid's for d, which spreads points evenly over flat
  /// bodies. The inside-outside function is homogeneous of degree 2 / north.
  Vec3 operator()(const Vec3& d) const {
    const double round = power(d.x, east) + power(d.y, east);
    const double f = std::pow(round, east / north) + power(d.z, north);
    const double r = std::pow(f, -0.5 * north);
    return {d.x * axes.x * r, d.y * axes.y * r, d.z * axes.z * r};
  }
};

Superquadric draw_superquadric(Random& random) {
  const Vec3 axes{random.uniform(0.5, 1.0), random.uniform(0.5, 1.0), random.uniform(0.5, 1.0)};
  const double east = random.uniform(0.25, 1.5), north = random.uniform(0.25, 1.5);
  return {axes, east, north};
}

/// Values at evenly spaced stations, joined smoothly (cosine), so that nothing overshoots.
struct Profile {
  std::vector<double> values;

  double operator()(double t) const {  // t in [-1, 1]
    const double at = std::clamp(0.5 * (t + 1.0), 0.0, 1.0) * static_cast<double>(values.size() - 1);
    const auto i = std::min(static_cast<size_t>(at), values.size() - 2);
    const double f = 0.5 - 0.5 * std::cos(kPi * (at - static_cast<double>(i)));
    return values[i] + f * (values[i + 1] - values[i]);
  }
};

Map draw_harmonics(Random& random) {
  const int degree = 4 + static_cast<int>(random.below(5));
  const double strength = random.uniform(0.15, 0.5), falloff = random.uniform(1.2, 2.2);
  // Coefficients of cos(m a) and sin(m a) by (l, m); those of degree l share strength x l^-falloff.
  struct Term {
    double cosine, sine;
  };
  std::vector<Term> terms;
  for (int l = 1; l <= degree; ++l) {
    for (int m = 0; m <= l; ++m) {
      const double size = strength * std::pow(l, -falloff);
      const double c = random.normal(), s = random.normal();
      terms.push_back({size * c, m > 0 ? size * s : 0.0});
    }
  }
  return [=](const Vec3& d) {
    // Fully normalised associated Legendre functions by their recurrences (Holmes and Featherstone 2002).
    const double azimuth = std::atan2(d.y, d.x), sine = std::hypot(d.x, d.y);
    double sum = 0.0, diagonal = 1.0;
    for (int m = 0; m <= degree; ++m) {
      if (m > 0) diagonal *= sine * (m == 1 ? std::sqrt(3.0) : std::sqrt((2.0 * m + 1.0) / (2.0 * m)));
      const double c = std::cos(m * azimuth), s = std::sin(m * azimuth);
      double before = 0.0, legendre = diagonal;
      for (int l = m; l <= degree; ++l) {
        if (l > m) {
          const double a = std::sqrt((2.0 * l - 1.0) * (2.0 * l + 1.0) / (double(l - m) * (l + m)));
          const double b = l - m < 2 ? 0.0
                                     : std::sqrt((2.0 * l + 1.0) * (l + m - 1.0) * (l - m - 1.0) /
                                                 (double(l - m) * (l + m) * (2.0 * l - 3.0)));
          const double next = a * d.z * legendre - b * before;
          before = legendre;
          legendre = next;
        }
        if (l == 0) continue;
        const Term& term = terms[static_cast<size_t>(l * (l + 1) / 2 + m - 1)];
        sum += legendre * (term.cosine * c + term.sine * s);
      }
    }
    return d * std::exp(1.1 * std::tanh(sum / 1.1));
  };
}

Map draw_noise(Random& random) {
  const uint32_t key = random.bits();
  const double height = random.uniform(0.15, 0.5), frequency = random.uniform(0.7, 1.5);
  const bool ridged = random.uniform() < 0.3;
  const int octaves = 1 + static_cast<int>(random.below(3));
  const Vec3 axes{random.uniform(0.6, 1.0), random.uniform(0.6, 1.0), random.uniform(0.6, 1.0)};
  return [=](const Vec3& d) {
    const Vec3 p = d * frequency + Vec3{7.5, 3.5, 5.5};
    const double noise =
        ridged ? 0.5 - 1.5 * std::abs(gradient_noise(p, key)) : fractal_noise(p, key, octaves);
    const double r = std::max(1.0 + height * noise, 0.25);
    return Vec3{d.x * axes.x * r, d.y * axes.y * r, d.z * axes.z * r};
  };
}

Map draw_twisted(Random& random) {
  const Superquadric body = draw_superquadric(random);
  const double twist = random.uniform(-2.5, 2.5), taper = random.uniform(-0.5, 0.5);
  const double waist = random.uniform(-0.3, 0.3);
  return [=](const Vec3& d) {
    const Vec3 p = body(d);
    const double t = p.z / body.axes.z;
    const double width = 1.0 + taper * t + waist * (t * t - 0.5);
    const double c = std::cos(twist * t), s = std::sin(twist * t);
    return Vec3{width * (c * p.x - s * p.y), width * (s * p.x + c * p.y), p.z};
  };
}

Map draw_lathed(Random& random) {
  const double height = random.uniform(0.6, 1.8);
  const Superquadric body{{1.0, 1.0, height}, 1.0, random.uniform(0.2, 0.9)};
  Profile profile;
  const uint32_t stations = 3 + random.below(6);
  for (uint32_t i = 0; i < stations; ++i) profile.values.push_back(random.uniform(0.3, 1.0));
  const bool fluted = random.uniform() < 0.3;
  const int flutes = 5 + static_cast<int>(random.below(10));
  const double depth = fluted ? random.uniform(0.02, 0.12) : 0.0, twist = random.uniform(-2.0, 2.0);
  return [=](const Vec3& d) {
    const Vec3 p = body(d);
    const double t = p.z / height;
    // Flutes fade towards the axis, where they would meet.
    const double fade = std::min(1.0, 4.0 * (p.x * p.x + p.y * p.y));
    const double around_axis = std::atan2(p.y, p.x) + twist * t;
    const double width = profile(t) * (1.0 - depth * fade * (0.5 + 0.5 * std::cos(flutes * around_axis)));
    return Vec3{width * p.x, width * p.y, p.z};
  };
}

struct ThinBody {
  Map map;
  double thickness;
};

ThinBody draw_sheet(Random& random) {
  const double thin = random.uniform(0.03, 0.09);
  const Superquadric body{
      {1.0, random.uniform(0.4, 1.0), thin}, random.uniform(0.3, 1.2), random.uniform(0.3, 0.6)};
  const uint32_t key = random.bits();
  const double height = random.uniform(0.1, 0.5), frequency = random.uniform(0.7, 1.6);
  const bool rolled = random.uniform() < 0.5;
  const double angle = random.uniform(0.6, 2.4);  // from the middle to an end of the roll
  // Rolling bends x around a circle and shearing moves z by a function of x and y: neither folds the body
  // over.
  return {[=](const Vec3& d) {
            Vec3 p = body(d);
            if (rolled) {
              const double r = 1.0 / angle;
              return Vec3{(r + p.z) * std::sin(p.x * angle), p.y, (r + p.z) * std::cos(p.x * angle)};
            }
            p.z += height * gradient_noise(Vec3{p.x, p.y, 0.0} * frequency + Vec3{3.3, 7.7, 0.5}, key) * 1.5;
            return p;
          },
          2.0 * thin};
}

Surface over_sphere(const Map& map) {
  Surface surface = to_surface(cube_sphere(kSides));
  for (Vec3& p : surface.points) p = map(normalised(p));
  return surface;
}

Surface of_field(const ImplicitBody& body) {
  // Three cells across the thinnest wall, within reason.
  const int cells = std::clamp(static_cast<int>(6.0 * body.half / body.thickness), kFewestCells, kMostCells);
  Surface surface = extract_isosurface(body.field, body.half, cells);
  keep_largest_piece(surface);
  if (surface.triangles.empty()) fail("render", "an implicit body has no inside");
  surface.thickness = body.thickness;
  return surface;
}

/// Turns the points by the rotation.
void turn(Surface& surface, Random& random) {
  // Uniform over all rotations: a uniform axis for z, a uniform angle around it.
  const double cosine = random.uniform(-1.0, 1.0), azimuth = random.uniform(0.0, 2.0 * kPi);
  const double angle = random.uniform(0.0, 2.0 * kPi);
  const Vec3 w = around({0.0, 0.0, 1.0}, cosine, azimuth);
  const Basis basis = basis_around(w);
  const Vec3 u = basis.first * std::cos(angle) + basis.second * std::sin(angle), v = cross(w, u);
  for (Vec3& p : surface.points) p = {dot(u, p), dot(v, p), dot(w, p)};
}

/// Moves the middle of the box around the points to the origin and the farthest of them to the radius.
void fit(Surface& surface, double radius) {
  Vec3 low{1e30, 1e30, 1e30}, high{-1e30, -1e30, -1e30};
  for (const Vec3& p : surface.points) {
    low = {std::min(low.x, p.x), std::min(low.y, p.y), std::min(low.z, p.z)};
    high = {std::max(high.x, p.x), std::max(high.y, p.y), std::max(high.z, p.z)};
  }
  const Vec3 centre = (low + high) * 0.5;
  double largest2 = 0.0;
  for (const Vec3& p : surface.points) largest2 = std::max(largest2, dot(p - centre, p - centre));
  if (!(largest2 > 0.0)) fail("render", "a body of {} points has no size", surface.points.size());
  const double scale = radius / std::sqrt(largest2);
  for (Vec3& p : surface.points) p = (p - centre) * scale;
  surface.thickness *= scale;
}

}  // namespace

Surface draw_body(Family family, Random& random) {
  switch (family) {
    case Family::kNoise:
      return over_sphere(draw_noise(random));
    case Family::kSuperquadric:
      return over_sphere(draw_superquadric(random));
    case Family::kTwisted:
      return over_sphere(draw_twisted(random));
    case Family::kLathed:
      return over_sphere(draw_lathed(random));
    case Family::kSheet: {
      const ThinBody body = draw_sheet(random);
      Surface surface = over_sphere(body.map);
      surface.thickness = body.thickness;
      return surface;
    }
    case Family::kBlend:
      return of_field(draw_blend(random));
    case Family::kCarved:
      return of_field(draw_carved(random));
    case Family::kTube:
      return of_field(draw_tube(random));
    case Family::kVessel:
      return of_field(draw_vessel(random));
    case Family::kHarmonics:
      break;
  }
  return over_sphere(draw_harmonics(random));
}

Mesh finish_body(Surface body, const ShapeOptions& options, Random& random) {
  turn(body, random);
  const bool bumpy = random.uniform() < 0.7;
  const double slope = bumpy ? options.bump * random.uniform() : 0.0;
  const Relief relief =
      options.map != nullptr ? draw_map_relief(*options.map, random) : draw_noise_relief(random);
  // Bumps are drawn for the unit ball. Displacement lengthens edges and moves the farthest point a little, so
  // the last word on facets is after it.
  fit(body, 1.0);
  refine(body, [&](const Vec3& p) { return 0.95 * options.facet(p * options.radius) / options.radius; });
  displace(body, relief, slope);
  fit(body, options.radius);
  refine(body, options.facet);
  // The cubics of the second refinement may leave the ball by a hair.
  fit(body, options.radius);
  return to_mesh(body);
}

Mesh make_shape(Family family, const ShapeOptions& options, Random& random) {
  return finish_body(draw_body(family, random), options, random);
}

}  // namespace opaline::render
