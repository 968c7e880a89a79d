#include "data/render/mueller.h"

#include <cmath>

namespace opaline::render {
namespace {

// row M for the Mueller matrix of an event, whose entries are
//   [mean  diff   0   0]
//   [diff  mean   0   0]
//   [0     0     re -im]
//   [0     0     im  re]
struct EventMatrix {
  double mean, diff, re, im;

  Stokes rows(const Stokes& row) const {
    return {row[0] * mean + row[1] * diff, row[0] * diff + row[1] * mean, row[2] * re + row[3] * im,
            row[3] * re - row[2] * im};
  }
};

EventMatrix reflection_matrix(const Fresnel& f, double weight) {
  return {0.5 * (f.reflect_s + f.reflect_p) * weight, 0.5 * (f.reflect_s - f.reflect_p) * weight,
          f.cross_real * weight, f.cross_imag * weight};
}

EventMatrix transmission_matrix(const Fresnel& f, double weight) {
  const double ts = 1.0 - f.reflect_s, tp = 1.0 - f.reflect_p;
  return {0.5 * (ts + tp) * weight, 0.5 * (ts - tp) * weight, std::sqrt(ts * tp) * weight, 0.0};
}

Mueller dense(const EventMatrix& m) {
  return {{{m.mean, m.diff, 0, 0}, {m.diff, m.mean, 0, 0}, {0, 0, m.re, -m.im}, {0, 0, m.im, m.re}}};
}

// Refers the rows to the axis normal to the plane of incidence.
template <int R>
void turn_to_incidence(Response<R>& response, const SurfaceEvent& event) {
  Vec3 s = cross(event.normal, event.direction);
  const double length2 = dot(s, s);
  // At normal incidence every axis is normal to the plane of incidence: keep the present one.
  if (!(length2 > 1e-24)) return;
  s = s * (1.0 / std::sqrt(length2));
  // The present axis in the frame (s, k x s) of the light, k = -direction.
  const double c = dot(response.axis, s), d = dot(response.axis, cross(s, event.direction));
  const double scale = 1.0 / (c * c + d * d);
  const double cos2 = (c * c - d * d) * scale, sin2 = 2.0 * c * d * scale;
  const auto turn = [cos2, sin2](Stokes& row) {
    const double r1 = row[1], r2 = row[2];
    row[1] = r1 * cos2 - r2 * sin2;
    row[2] = r1 * sin2 + r2 * cos2;
  };
  for (int i = 0; i < R; ++i) {
    turn(response.pure[static_cast<size_t>(i)]);
    if (!event.inside) turn(response.scattered[static_cast<size_t>(i)]);
  }
  response.axis = s;
}

}  // namespace

Mueller frame_rotation(double angle) {
  const double c = std::cos(2.0 * angle), s = std::sin(2.0 * angle);
  return {{{1, 0, 0, 0}, {0, c, s, 0}, {0, -s, c, 0}, {0, 0, 0, 1}}};
}

Mueller reflection(const Fresnel& f) {
  return dense(reflection_matrix(f, 1.0));
}

Mueller transmission(const Fresnel& f) {
  return dense(transmission_matrix(f, 1.0));
}

Mueller depolariser() {
  return {{{1, 0, 0, 0}, {0, 0, 0, 0}, {0, 0, 0, 0}, {0, 0, 0, 0}}};
}

Mueller product(const Mueller& a, const Mueller& b) {
  Mueller c{};
  for (size_t i = 0; i < 4; ++i)
    for (size_t j = 0; j < 4; ++j)
      for (size_t k = 0; k < 4; ++k) c[i][j] += a[i][k] * b[k][j];
  return c;
}

Stokes apply(const Mueller& m, const Stokes& s) {
  Stokes result{};
  for (size_t i = 0; i < 4; ++i)
    for (size_t k = 0; k < 4; ++k) result[i] += m[i][k] * s[k];
  return result;
}

template <int R>
void Response<R>::reflect(const SurfaceEvent& event) {
  turn_to_incidence(*this, event);
  const EventMatrix m = reflection_matrix(event.fresnel, event.weight);
  for (Stokes& row : pure) row = m.rows(row);
  // Scattered light inside is scalar, outside it is not.
  for (Stokes& row : scattered) row = event.inside ? Stokes{row[0] * m.mean, 0, 0, 0} : m.rows(row);
}

template <int R>
void Response<R>::transmit(const SurfaceEvent& event) {
  turn_to_incidence(*this, event);
  const EventMatrix m = transmission_matrix(event.fresnel, event.weight);
  for (Stokes& row : pure) row = m.rows(row);
  // Traced from the camera, a path that goes in is light that comes out: depolarised first, so that of the
  // product only the column of S0 is left. A path that goes out is light that comes in: into S0.
  for (Stokes& row : scattered) {
    row = event.inside ? Stokes{row[0] * m.mean, row[0] * m.diff, 0, 0}
                       : Stokes{row[0] * m.mean + row[1] * m.diff, 0, 0, 0};
  }
}

template struct Response<1>;
template struct Response<3>;

Response<3> camera_response(const Vec3& axis) {
  Response<3> response;
  for (size_t i = 0; i < 3; ++i) response.pure[i][i] = response.scattered[i][i] = 1.0;
  response.axis = axis;
  return response;
}

Response<1> scalar_response(const Vec3& direction) {
  Response<1> response;
  response.pure[0] = response.scattered[0] = {1.0, 0.0, 0.0, 0.0};
  response.axis = basis_around(direction).first;
  return response;
}

std::array<double, 3> first_column(const std::array<Stokes, 3>& rows) {
  return {rows[0][0], rows[1][0], rows[2][0]};
}

}  // namespace opaline::render
