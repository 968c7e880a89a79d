#include "data/render/guide.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "data/render/emitter.h"
#include "data/render/sequence.h"
#include "data/render/walk.h"

namespace opaline::render {
namespace {

constexpr double kPi = std::numbers::pi;
/// Bins are counted with light to this power: rare directions come up more often than their light deserves,
/// which costs little where they are rightly rare and saves outliers where too few sub-paths have shown them.
constexpr float kFlatten = 0.7F;
/// Share of samples that any direction is left to.
constexpr double kFloor = 0.05;
/// Largest |g| of the lobe that the light is multiplied by.
constexpr double kSharpest = 0.8;
/// Light darker than this on all colours is not followed.
constexpr double kDark = 1e-2;
/// Light that single-precision counts could lose.
constexpr double kFaintest = 1e-30;
/// Bends the sides' coordinates: s = t (1 + c) / (1 + c |t|) for t in [-1, 1].
constexpr double kWarp = 0.27;

constexpr int kSide = DirectionBins::kSide;
constexpr int kPatch = DirectionBins::kPatch;
constexpr int kPatchSide = kSide / kPatch;  // patches along a side
constexpr int kPatchBins = kPatch * kPatch;

/// Place of a bin on its side.
struct BinCell {
  int side, row, column;
};

int bin_number(const BinCell& c) {
  const int patch = (c.side * kPatchSide + c.row / kPatch) * kPatchSide + c.column / kPatch;
  return patch * kPatchBins + c.row % kPatch * kPatch + c.column % kPatch;
}

BinCell bin_cell(int bin) {
  const int patch = bin / kPatchBins, within = bin % kPatchBins;
  return {patch / (kPatchSide * kPatchSide), patch / kPatchSide % kPatchSide * kPatch + within / kPatch,
          patch % kPatchSide * kPatch + within % kPatch};
}

/// The direction at (row, column) of a side, in bins from its corner.
Vec3 side_direction(int side, double row, double column) {
  const auto coordinate = [](double cell) {
    const double s = 2.0 * cell / kSide - 1.0;
    return s / (1.0 + kWarp - kWarp * std::abs(s));
  };
  const double a = coordinate(row), b = coordinate(column), along = side % 2 == 1 ? 1.0 : -1.0;
  switch (side / 2) {
    case 0:
      return normalised({along, a, b});
    case 1:
      return normalised({b, along, a});
    default:
      return normalised({a, b, along});
  }
}

using PatchAxis = std::array<float, DirectionBins::kPatches>;
struct PatchDirections {
  PatchAxis x, y, z;
  PatchDirections() {
    for (int p = 0; p < DirectionBins::kPatches; ++p) {
      const Vec3 d = DirectionBins::patch_direction(p);
      const auto i = static_cast<size_t>(p);
      x[i] = static_cast<float>(d.x);
      y[i] = static_cast<float>(d.y);
      z[i] = static_cast<float>(d.z);
    }
  }
};

}  // namespace

DirectionBins::Place DirectionBins::find(const Vec3& d) {
  const double x = std::abs(d.x), y = std::abs(d.y), z = std::abs(d.z);
  int side = 0;
  double along = 0.0, a = 0.0, b = 0.0;
  if (x >= y && x >= z) {
    side = d.x > 0.0 ? 1 : 0, along = x, a = d.y, b = d.z;
  } else if (y >= z) {
    side = d.y > 0.0 ? 3 : 2, along = y, a = d.z, b = d.x;
  } else {
    side = d.z > 0.0 ? 5 : 4, along = z, a = d.x, b = d.y;
  }
  a /= along;
  b /= along;
  const double bend_a = 1.0 + kWarp * std::abs(a), bend_b = 1.0 + kWarp * std::abs(b);
  const auto cell = [](double t, double bend) {
    const double s = t * (1.0 + kWarp) / bend;
    return std::clamp(static_cast<int>(0.5 * (s + 1.0) * kSide), 0, kSide - 1);
  };
  // d omega = da db / (1 + a^2 + b^2)^(3/2) = da db along^3, ds/da = (1 + c) / (1 + c |a|)^2, and a bin is
  // 2 / kSide wide in s.
  const double stretch = (1.0 + kWarp) * (1.0 + kWarp) / (bend_a * bend_a * bend_b * bend_b);
  const double density = 0.25 * kSide * kSide * stretch / (along * along * along);
  return {bin_number({side, cell(a, bend_a), cell(b, bend_b)}), density};
}

Vec3 DirectionBins::direction(int bin, double u, double v) {
  const BinCell c = bin_cell(bin);
  return side_direction(c.side, c.row + u, c.column + v);
}

Vec3 DirectionBins::patch_direction(int patch) {
  const BinCell c = bin_cell(patch * kPatchBins);
  return side_direction(c.side, c.row + 0.5 * kPatch, c.column + 0.5 * kPatch);
}

Guide::Guide(const World& world, const Illumination& light, const Vec3& low, const Vec3& high, Random random,
             const GuideOptions& options)
    : low_(low) {
  const Vec3 size = high - low;
  const Emitter emitter(light, (low + high) * 0.5, 0.5 * norm(size));
  if (options.photons == 0 || emitter.dark()) return;
  side_ = options.cells;
  const auto side = static_cast<double>(side_);
  const double thinnest = 1e-3 * norm(size);  // a flat box has cells of some width too
  const Vec3 wide{std::max(size.x, thinnest), std::max(size.y, thinnest), std::max(size.z, thinnest)};
  cells_per_length_ = {side / wide.x, side / wide.y, side / wide.z};
  const double step = std::min({wide.x, wide.y, wide.z}) / side;
  slots_.assign(static_cast<size_t>(side_ * side_ * side_), -1);
  // Every second sub-path's light apart: light of two that fall into one bin tells how concentrated it is.
  std::deque<std::array<float, DirectionBins::kCount>> seconds;

  const auto leave = [&](const Vec3& position, const DirectionBins::Place& place, double weight,
                         bool second) {
    if (!(weight > kFaintest)) return;
    // Jittered by up to half a cell: neighbouring cells share what they know.
    const Vec3 p = position + Vec3{(random.uniform() - 0.5) / cells_per_length_.x,
                                   (random.uniform() - 0.5) / cells_per_length_.y,
                                   (random.uniform() - 0.5) / cells_per_length_.z};
    int32_t& slot = slots_[static_cast<size_t>(cell_index(p))];
    if (slot < 0) {
      slot = static_cast<int32_t>(cells_.size());
      cells_.emplace_back();
      seconds.emplace_back();
    }
    const auto index = static_cast<size_t>(slot), bin = static_cast<size_t>(place.bin);
    (second ? seconds[index] : cells_[index].share)[bin] += static_cast<float>(weight);
  };

  for (int64_t photon = 0; photon < options.photons; ++photon) {
    auto [origin, direction, flux] = emitter.emit(uniform<Emitter::kDimensions>(random));
    if (!(largest(flux) > 0.0)) continue;
    bool inside = false;
    double length = 0.0;
    for (;;) {
      Hit hit;
      if (!world.geometry->intersect(origin, direction, kInfinity, hit)) break;
      const double cosine = dot(direction, hit.normal);
      if ((cosine > 0.0) != inside) break;
      if (inside) {
        // Jittered steps, so that every part of a cell's chord counts alike.
        const DirectionBins::Place place = DirectionBins::find(-direction);
        for (double t = step * random.uniform(); t < hit.distance; t += step) {
          leave(origin + direction * t, place, mean(world.medium.transmittance(length + t)), photon % 2 == 1);
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

  double moment = 0.0, all = 0.0;
  for (size_t i = 0; i < cells_.size(); ++i) {
    double first = 0.0, second = 0.0, both = 0.0;
    for (size_t b = 0; b < DirectionBins::kCount; ++b) {
      const auto x = static_cast<double>(cells_[i].share[b]), y = static_cast<double>(seconds[i][b]);
      first += x;
      second += y;
      both += x * y;
      cells_[i].share[b] += seconds[i][b];
    }
    if (first > 0.0 && second > 0.0) {
      moment += (first + second) * both / (first * second);
      all += first + second;
    }
    smooth(cells_[i]);
  }
  concentration_ = all > 0.0 ? DirectionBins::kCount * moment / all : 0.0;
}

/// Counts to shares: flattened, blurred into the neighbouring bins, never zero.
void Guide::smooth(Cell& cell) {
  const auto counts = cell.share;
  cell.share.fill(0.0F);
  for (int bin = 0; bin < DirectionBins::kCount; ++bin) {
    const float count = counts[static_cast<size_t>(bin)];
    if (!(count > 0.0F)) continue;
    const float flat = std::pow(count, kFlatten);
    const BinCell c = bin_cell(bin);
    for (int i = -1; i <= 1; ++i) {
      for (int j = -1; j <= 1; ++j) {
        const int row = c.row + i, column = c.column + j;
        const bool within = row >= 0 && row < kSide && column >= 0 && column < kSide;
        // Beyond the side's edge: the bin on the next side that lies in that direction.
        const int there = within ? bin_number({c.side, row, column})
                                 : DirectionBins::find(side_direction(c.side, row + 0.5, column + 0.5)).bin;
        cell.share[static_cast<size_t>(there)] += flat * (i == 0 ? 0.5F : 0.25F) * (j == 0 ? 0.5F : 0.25F);
      }
    }
  }
  double total = 0.0;
  for (const float value : cell.share) total += static_cast<double>(value);
  const double scale = (1.0 - kFloor) / total, floor = kFloor / DirectionBins::kCount;
  for (size_t patch = 0; patch < DirectionBins::kPatches; ++patch) {
    float sum = 0.0F;
    for (size_t i = patch * kPatchBins; i < (patch + 1) * kPatchBins; ++i) {
      cell.share[i] = static_cast<float>(static_cast<double>(cell.share[i]) * scale + floor);
      sum += cell.share[i];
    }
    cell.patch[patch] = sum;
  }
}

int64_t Guide::cell_index(const Vec3& position) const {
  const Vec3 p = position - low_;
  const auto index = [this](double x) { return std::clamp(static_cast<int64_t>(x), int64_t{0}, side_ - 1); };
  const int64_t i = index(p.x * cells_per_length_.x), j = index(p.y * cells_per_length_.y),
                k = index(p.z * cells_per_length_.z);
  return (k * side_ + j) * side_ + i;
}

const Guide::Cell* Guide::find(const Vec3& position) const {
  if (side_ == 0) return nullptr;
  const int32_t slot = slots_[static_cast<size_t>(cell_index(position))];
  return slot < 0 ? nullptr : &cells_[static_cast<size_t>(slot)];
}

Guide::Directions Guide::directions(const Vec3& position, const Vec3& direction, double g) const {
  static const PatchDirections patches;
  Directions result;
  result.cell_ = find(position);
  if (result.cell_ == nullptr) return result;
  // Henyey-Greenstein at the patches' middles, with lobes no narrower than patches.
  const auto lobe = static_cast<float>(std::clamp(g, -kSharpest, kSharpest));
  const float top = 1.0F - lobe * lobe, base = 1.0F + lobe * lobe, twice = 2.0F * lobe;
  const auto x = static_cast<float>(direction.x), y = static_cast<float>(direction.y),
             z = static_cast<float>(direction.z);
  for (size_t i = 0; i < DirectionBins::kPatches; ++i) {
    const float cosine = x * patches.x[i] + y * patches.y[i] + z * patches.z[i];
    const float spread = base - twice * cosine;
    result.weight_[i] = result.cell_->patch[i] * top / (spread * std::sqrt(spread));
  }
  float total = 0.0F;
  for (const float weight : result.weight_) total += weight;
  result.total_ = total;
  return result;
}

Vec3 Guide::Directions::sample(double pick, Random& random) const {
  float rest = static_cast<float>(pick) * total_;
  size_t patch = 0;
  for (; patch + 1 < DirectionBins::kPatches && rest >= weight_[patch]; ++patch) rest -= weight_[patch];
  const size_t first = patch * kPatchBins;
  float part = random.uniform_float() * cell_->patch[patch];
  size_t bin = first;
  for (; bin + 1 < first + kPatchBins && part >= cell_->share[bin]; ++bin) part -= cell_->share[bin];
  const double u = random.uniform(), v = random.uniform();
  return DirectionBins::direction(static_cast<int>(bin), u, v);
}

double Guide::Directions::density(const Vec3& direction) const {
  if (cell_ == nullptr) return 0.0;
  const DirectionBins::Place place = DirectionBins::find(direction);
  const auto bin = static_cast<size_t>(place.bin), patch = bin / kPatchBins;
  return static_cast<double>(weight_[patch] / total_ * (cell_->share[bin] / cell_->patch[patch])) *
         place.density;
}

}  // namespace opaline::render
