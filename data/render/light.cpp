#include "data/render/light.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/error.h"

namespace opaline::render {
namespace {

constexpr double kPi = std::numbers::pi;

// Row and column, in texels, of the point that looks along d; their centres are at halves.
struct GridPoint {
  double row, column;
};

GridPoint to_grid(const Vec3& d, int64_t width, int64_t height) {
  const double longitude = std::atan2(d.x, -d.z);
  const double latitude = std::acos(std::clamp(d.y, -1.0, 1.0));
  return {latitude / kPi * static_cast<double>(height),
          (longitude / (2.0 * kPi) + 0.5) * static_cast<double>(width)};
}

Vec3 from_grid(double row, double column, int64_t width, int64_t height) {
  const double latitude = row / static_cast<double>(height) * kPi;
  const double longitude = (column / static_cast<double>(width) - 0.5) * 2.0 * kPi;
  const double s = std::sin(latitude);
  return {s * std::sin(longitude), std::cos(latitude), -s * std::cos(longitude)};
}

}  // namespace

Harmonics harmonics(const Vec3& d) {
  const double a = 0.5 * std::sqrt(3.0 / kPi), b = 0.5 * std::sqrt(15.0 / kPi),
               c = 0.25 * std::sqrt(5.0 / kPi);
  return {0.5 / std::sqrt(kPi),
          a * d.y,
          a * d.z,
          a * d.x,
          b * d.x * d.y,
          b * d.y * d.z,
          c * (3.0 * d.z * d.z - 1.0),
          b * d.x * d.z,
          0.5 * b * (d.x * d.x - d.y * d.y)};
}

Environment::Environment(std::vector<Rgb> texels, int64_t width) : texels_(std::move(texels)), width_(width) {
  const auto count = static_cast<int64_t>(texels_.size());
  if (width < 1 || count == 0 || count % width != 0) {
    fail("environment", "{} texels in rows of {}", count, width);
  }
  for (const Rgb& texel : texels_) {
    for (const double value : texel) {
      if (!(value >= 0.0 && std::isfinite(value))) fail("environment", "holds a radiance of {}", value);
    }
  }
  height_ = count / width;
  accumulate();
}

void Environment::accumulate() {
  cumulative_.clear();
  cumulative_.reserve(texels_.size());
  const auto at = [this](int64_t row, int64_t column) {
    return mean(texels_[static_cast<size_t>(std::clamp<int64_t>(row, 0, height_ - 1) * width_ +
                                            (column + width_) % width_)]);
  };
  double sum = 0.0;
  for (int64_t row = 0; row < height_; ++row) {
    for (int64_t column = 0; column < width_; ++column) {
      // The texel's mean where it is read bilinearly: with an eighth of the neighbours on each side.
      double brightness = 0.0;
      for (int64_t i = -1; i <= 1; ++i)
        for (int64_t j = -1; j <= 1; ++j)
          brightness += (i == 0 ? 0.75 : 0.125) * (j == 0 ? 0.75 : 0.125) * at(row + i, column + j);
      sum += band(row) * brightness;
      cumulative_.push_back(sum);
    }
  }
}

double Environment::band(int64_t row) const {
  const double step = kPi / static_cast<double>(height_);
  return std::cos(step * static_cast<double>(row)) - std::cos(step * static_cast<double>(row + 1));
}

Rgb Environment::radiance(const Vec3& d) const {
  if (texels_.size() == 1) return texels_[0];
  const GridPoint p = to_grid(d, width_, height_);
  const double row = std::clamp(p.row - 0.5, 0.0, static_cast<double>(height_ - 1));
  const double column = p.column - 0.5;
  const auto r0 = static_cast<int64_t>(row);
  const auto c0 = static_cast<int64_t>(std::floor(column));
  const double fr = row - static_cast<double>(r0), fc = column - static_cast<double>(c0);
  const int64_t r1 = std::min(r0 + 1, height_ - 1);
  const int64_t left = (c0 + width_) % width_, right = (c0 + 1) % width_;
  const auto at = [this](int64_t r, int64_t c) -> const Rgb& {
    return texels_[static_cast<size_t>(r * width_ + c)];
  };
  const Rgb &a = at(r0, left), &b = at(r0, right), &c = at(r1, left), &e = at(r1, right);
  Rgb result;
  for (size_t k = 0; k < 3; ++k) {
    result[k] = (1.0 - fr) * ((1.0 - fc) * a[k] + fc * b[k]) + fr * ((1.0 - fc) * c[k] + fc * e[k]);
  }
  return result;
}

template <class F>
void Environment::integrate(const F& f) const {
  // Midpoints, at least 256 rows: 5e-5 of the bands that we need, and exact weights by band.
  const int64_t rows = height_ * ((255 + height_) / height_), columns = std::max<int64_t>(2 * rows, width_);
  for (int64_t i = 0; i < rows; ++i) {
    const double share = static_cast<double>(height_) / static_cast<double>(rows);
    const double band = std::cos(kPi * static_cast<double>(i) / static_cast<double>(rows)) -
                        std::cos(kPi * static_cast<double>(i + 1) / static_cast<double>(rows));
    const double solid_angle = band * 2.0 * kPi / static_cast<double>(columns);
    for (int64_t j = 0; j < columns; ++j) {
      const double column =
          (static_cast<double>(j) + 0.5) * static_cast<double>(width_) / static_cast<double>(columns);
      const Vec3 d = from_grid((static_cast<double>(i) + 0.5) * share, column, width_, height_);
      f(d, radiance(d), solid_angle);
    }
  }
}

Rgb Environment::fluence() const {
  Rgb sum{};
  integrate([&sum](const Vec3&, const Rgb& light, double solid_angle) {
    for (size_t c = 0; c < 3; ++c) sum[c] += light[c] * solid_angle;
  });
  return sum;
}

Rgb Environment::irradiance(const Vec3& n) const {
  Rgb sum{};
  integrate([&](const Vec3& d, const Rgb& light, double solid_angle) {
    const double cosine = std::max(0.0, dot(d, n));
    for (size_t c = 0; c < 3; ++c) sum[c] += light[c] * cosine * solid_angle;
  });
  return sum;
}

std::array<Harmonics, 3> Environment::project() const {
  std::array<Harmonics, 3> result{};
  integrate([&result](const Vec3& d, const Rgb& light, double solid_angle) {
    const Harmonics y = harmonics(d);
    for (size_t c = 0; c < 3; ++c)
      for (size_t k = 0; k < y.size(); ++k) result[c][k] += light[c] * y[k] * solid_angle;
  });
  return result;
}

Vec3 Environment::sample(double pick, double u, double v) const {
  const double wanted = pick * cumulative_.back();
  const auto found = std::upper_bound(cumulative_.begin(), cumulative_.end(), wanted);
  const int64_t index = std::min(static_cast<int64_t>(found - cumulative_.begin()),
                                 static_cast<int64_t>(cumulative_.size()) - 1);
  const double row = static_cast<double>(index / width_), column = static_cast<double>(index % width_);
  // Uniform in solid angle inside the texel: uniform in the cosine of the latitude.
  const double top = std::cos(kPi * row / static_cast<double>(height_));
  const double latitude = std::acos(std::clamp(top - band(index / width_) * u, -1.0, 1.0));
  return from_grid(latitude / kPi * static_cast<double>(height_), column + v, width_, height_);
}

double Environment::density(const Vec3& d) const {
  if (!(cumulative_.back() > 0.0)) return 0.0;
  const GridPoint p = to_grid(d, width_, height_);
  const int64_t row = std::clamp(static_cast<int64_t>(p.row), int64_t{0}, height_ - 1);
  const int64_t column = std::clamp(static_cast<int64_t>(p.column), int64_t{0}, width_ - 1);
  const auto index = static_cast<size_t>(row * width_ + column);
  const double share = cumulative_[index] - (index > 0 ? cumulative_[index - 1] : 0.0);
  return share / cumulative_.back() * static_cast<double>(width_) / (2.0 * kPi * band(row));
}

void Environment::scale(double factor) {
  for (Rgb& texel : texels_)
    for (double& value : texel) value *= factor;
  for (double& value : cumulative_) value *= factor;
}

void Environment::turn(double share) {
  const auto columns = static_cast<std::ptrdiff_t>(std::floor(share * static_cast<double>(width_)));
  for (int64_t row = 0; row < height_; ++row) {
    const auto first = texels_.begin() + row * width_;
    std::rotate(first, first + (columns % width_ + width_) % width_, first + width_);
  }
  accumulate();
}

bool Flash::hit(const Vec3& origin, const Vec3& direction) const {
  const Vec3 to_centre = centre - origin;
  const double along = dot(to_centre, direction);
  if (!(along > 0.0)) return false;
  return dot(to_centre, to_centre) - along * along <= radius * radius;
}

double Flash::irradiance(const Vec3& point) const {
  const Vec3 to_centre = centre - point;
  return kPi * radiance * radius * radius / dot(to_centre, to_centre);
}

}  // namespace opaline::render
