#include "data/render/guide.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "data/render/path.h"

namespace opaline::render {
namespace {

constexpr double kPi = std::numbers::pi;
/// The blur around a stored direction is a Henyey-Greenstein lobe: half of it within 5 degrees (about what
/// the flash subtends from inside, and what directions vary by in a cell), with tails that reach everywhere.
constexpr double kLobe = 0.95;
/// Light darker than this on all colours is not followed.
constexpr double kDark = 1e-2;

struct Deposit {
  int64_t cell;
  Vec3 direction;  // towards the light
  double weight;
};

double mean(const Rgb& c) {
  return (c[0] + c[1] + c[2]) / 3.0;
}

struct LightRay {
  Vec3 origin;
  Vec3 direction;
};

/// A ray of light towards the ball around the object, from the flash or the environment in proportion to what
/// they send there.
class Emitter {
 public:
  Emitter(const Illumination& light, const Vec3& centre, double radius)
      : light_(light), centre_(centre), radius_(radius) {
    const double flash = light.flash.radiance > 0.0 ? light.flash.irradiance(centre) : 0.0;
    const double environment = mean(light.environment.fluence());
    dark_ = !(flash + environment > 0.0);
    flash_share_ = dark_ ? 0.0 : flash / (flash + environment);
  }

  bool dark() const { return dark_; }

  LightRay emit(Random& random) const {
    if (random.uniform() < flash_share_) {
      const Vec3 axis = normalised(light_.flash.centre - centre_);
      const Vec3 from = light_.flash.centre + disc(axis, light_.flash.radius, random);
      return {from, normalised(centre_ + disc(axis, radius_, random) - from)};
    }
    const Vec3 towards = light_.environment.sample(random);
    return {centre_ + towards * (2.0 * radius_) + disc(towards, radius_, random), -towards};
  }

 private:
  static Vec3 disc(const Vec3& axis, double radius, Random& random) {
    const Basis basis = basis_around(axis);
    const double r = radius * std::sqrt(random.uniform()), angle = 2.0 * kPi * random.uniform();
    return basis.first * (r * std::cos(angle)) + basis.second * (r * std::sin(angle));
  }

  const Illumination& light_;
  Vec3 centre_;
  double radius_;
  double flash_share_ = 0.0;
  bool dark_ = true;
};

}  // namespace

Guide::Guide(const World& world, const Illumination& light, const Vec3& low, const Vec3& high, Random random,
             const GuideOptions& options)
    : low_(low), side_(options.cells) {
  const auto side = static_cast<double>(side_);
  const Vec3 size = high - low;
  // A flat body has one layer of cells, and steps through a thin one are bounded by its length.
  const auto cells_per = [side](double length) { return length > 0.0 ? side / length : 0.0; };
  cells_per_length_ = {cells_per(size.x), cells_per(size.y), cells_per(size.z)};
  const double step = std::max(0.5 * std::min({size.x, size.y, size.z}) / side, norm(size) / 1024.0);
  const Emitter emitter(light, (low + high) * 0.5, 0.5 * norm(size));
  cells_.resize(static_cast<size_t>(side_ * side_ * side_));
  if (emitter.dark()) return;

  std::vector<Deposit> deposits;
  for (int64_t photon = 0; photon < options.photons; ++photon) {
    auto [origin, direction] = emitter.emit(random);
    bool inside = false;
    double length = 0.0;
    for (;;) {
      Hit hit;
      if (!world.geometry->intersect(origin, direction, kInfinity, hit)) break;
      const double cosine = dot(direction, hit.normal);
      if ((cosine > 0.0) != inside) break;
      if (inside) {
        // Jittered steps, so that every part of a cell's chord counts alike.
        for (double t = step * random.uniform(); t < hit.distance; t += step) {
          const Vec3 p = origin + direction * t;
          if (const Cell* cell = find(p); cell != nullptr) {
            deposits.push_back(
                {cell - cells_.data(), -direction, mean(world.medium.transmittance(length + t))});
          }
        }
        length += hit.distance;
        if (mean(world.medium.transmittance(length)) < kDark) break;
      }
      const double eta = inside ? 1.0 / world.index : world.index;
      const Fresnel f = fresnel(std::abs(cosine), eta);
      // After a long way through a clear body, roulette.
      if (length > 20.0 * norm(size) && random.uniform() < 0.5) break;
      if (f.total || random.uniform() < f.reflectance()) {
        direction = reflect(direction, hit.normal);
      } else {
        direction = refract(direction, cosine < 0.0 ? hit.normal : -hit.normal, f, eta);
        inside = !inside;
      }
      origin = world.geometry->leave(hit, direction);
    }
  }

  // Each cell keeps some of its deposits, drawn in proportion to their weights at even spacing.
  std::stable_sort(deposits.begin(), deposits.end(),
                   [](const Deposit& a, const Deposit& b) { return a.cell < b.cell; });
  for (size_t begin = 0; begin < deposits.size();) {
    size_t end = begin;
    double total = 0.0;
    for (; end < deposits.size() && deposits[end].cell == deposits[begin].cell; ++end) {
      total += deposits[end].weight;
    }
    Cell& cell = cells_[static_cast<size_t>(deposits[begin].cell)];
    const double spacing = total / static_cast<double>(kDirections);
    double wanted = spacing * random.uniform(), sum = 0.0;
    size_t slot = 0;
    for (size_t i = begin; i < end && slot < kDirections; ++i) {
      sum += deposits[i].weight;
      for (; slot < kDirections && wanted < sum; wanted += spacing) {
        cell.directions[slot++] = deposits[i].direction;
      }
    }
    for (; slot < kDirections; ++slot) cell.directions[slot] = deposits[end - 1].direction;  // rounding
    cell.known = true;
    begin = end;
  }
}

const Guide::Cell* Guide::find(const Vec3& position) const {
  if (side_ == 0) return nullptr;
  const Vec3 p = position - low_;
  const auto index = [this](double x) { return std::clamp(static_cast<int64_t>(x), int64_t{0}, side_ - 1); };
  const int64_t i = index(p.x * cells_per_length_.x), j = index(p.y * cells_per_length_.y),
                k = index(p.z * cells_per_length_.z);
  return &cells_[static_cast<size_t>((k * side_ + j) * side_ + i)];
}

bool Guide::sample(const Vec3& position, Random& random, Vec3& direction) const {
  const Cell* cell = find(position);
  if (cell == nullptr || !cell->known) return false;
  const Vec3& centre = cell->directions[random.below(kDirections)];
  const double cosine = sample_henyey_greenstein(random.uniform(), kLobe);
  direction = around(centre, cosine, 2.0 * kPi * random.uniform());
  return true;
}

double Guide::density(const Vec3& position, const Vec3& direction) const {
  const Cell* cell = find(position);
  if (cell == nullptr || !cell->known) return 0.0;
  double sum = 0.0;
  for (const Vec3& centre : cell->directions) sum += henyey_greenstein(dot(centre, direction), kLobe);
  return sum / static_cast<double>(kDirections);
}

}  // namespace opaline::render
