#include "data/render/isosurface.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

namespace opaline::render {
namespace {

constexpr int kBlock = 4;  // cells along a block that is skipped as a whole where it is far from the surface

/// Whether a cell with these corners inside (bit x + 2 y + 4 z) holds more than one sheet: a side with two
/// opposite corners inside and two outside, or more than one group of connected corners inside or outside.
constexpr bool is_ambiguous(unsigned inside) {
  for (unsigned kind = 0; kind < 2; ++kind) {
    const unsigned set = kind == 0 ? inside : ~inside & 0xFFU;
    if (set == 0) continue;
    unsigned reached = set & (~set + 1U);
    for (int step = 0; step < 8; ++step) {
      for (unsigned c = 0; c < 8; ++c) {
        if ((reached >> c & 1U) == 0) continue;
        for (const unsigned axis : {1U, 2U, 4U}) reached |= set & (1U << (c ^ axis));
      }
    }
    if (reached != set) return true;
  }
  for (const unsigned axis : {1U, 2U, 4U}) {
    const unsigned u = axis == 1U ? 2U : 1U, v = axis == 4U ? 2U : 4U;
    for (const unsigned base : {0U, axis}) {
      const auto bit = [&](unsigned c) { return inside >> c & 1U; };
      if (bit(base) == bit(base ^ u ^ v) && bit(base ^ u) == bit(base ^ v) && bit(base) != bit(base ^ u)) {
        return true;
      }
    }
  }
  return false;
}

constexpr std::array<bool, 256> ambiguous_cells() {
  std::array<bool, 256> table{};
  for (unsigned i = 0; i < 256; ++i) table[i] = is_ambiguous(i);
  return table;
}
constexpr std::array<bool, 256> kAmbiguous = ambiguous_cells();

class Grid {
 public:
  Grid(const Field& field, double half, int cells)
      : field_(field), n_((cells + kBlock - 1) / kBlock * kBlock), half_(half), step_(2.0 * half / n_) {
    const auto corners = static_cast<size_t>(n_ + 1);
    values_.assign(corners * corners * corners, kUnknown);
    const auto blocks = static_cast<size_t>(n_ / kBlock);
    near_.assign(blocks * blocks * blocks, false);
  }

  Surface extract();

 private:
  static constexpr float kUnknown = 1e30F, kFar = 1e3F;

  size_t corner(int i, int j, int k) const {
    return (static_cast<size_t>(k) * static_cast<size_t>(n_ + 1) + static_cast<size_t>(j)) *
               static_cast<size_t>(n_ + 1) +
           static_cast<size_t>(i);
  }
  size_t corner_of(const std::array<int, 3>& cell, unsigned bits) const {
    return corner(cell[0] + static_cast<int>(bits & 1U), cell[1] + static_cast<int>(bits >> 1 & 1U),
                  cell[2] + static_cast<int>(bits >> 2 & 1U));
  }
  size_t number(const std::array<int, 3>& cell) const {
    return (static_cast<size_t>(cell[2]) * static_cast<size_t>(n_) + static_cast<size_t>(cell[1])) *
               static_cast<size_t>(n_) +
           static_cast<size_t>(cell[0]);
  }
  Vec3 position(double i, double j, double k) const {
    return {i * step_ - half_, j * step_ - half_, k * step_ - half_};
  }
  unsigned inside(const std::array<int, 3>& cell) const {
    unsigned bits = 0;
    for (unsigned c = 0; c < 8; ++c) bits |= values_[corner_of(cell, c)] < 0.0F ? 1U << c : 0U;
    return bits;
  }

  std::vector<bool>::reference near(int i, int j, int k) {
    const int blocks = n_ / kBlock;
    return near_[static_cast<size_t>((k / kBlock * blocks + j / kBlock) * blocks + i / kBlock)];
  }
  void mark_around(const std::array<int, 3>& cell);

  void sample();
  void find_cells();
  void resolve();
  Vec3 place(const std::array<int, 3>& cell) const;
  Vec3 project(const Vec3& start) const;

  const Field& field_;
  int n_;
  double half_, step_;
  std::vector<float> values_;              // of the corners
  std::vector<bool> near_;                 // blocks that the surface may pass
  std::vector<std::array<int, 3>> cells_;  // that the surface passes
};

/// Evaluates the field near the surface; elsewhere a block has one sign.
void Grid::sample() {
  // A tenth more than half the diagonal: fields may be a little steeper than they promise.
  const double reach = 0.55 * std::sqrt(3.0) * kBlock * step_;
  for (int bk = 0; bk < n_; bk += kBlock) {
    for (int bj = 0; bj < n_; bj += kBlock) {
      for (int bi = 0; bi < n_; bi += kBlock) {
        const double middle = field_(position(bi + 0.5 * kBlock, bj + 0.5 * kBlock, bk + 0.5 * kBlock));
        const bool is_near = !(std::abs(middle) > reach);
        near(bi, bj, bk) = is_near;
        for (int k = bk; k <= bk + kBlock; ++k) {
          for (int j = bj; j <= bj + kBlock; ++j) {
            for (int i = bi; i <= bi + kBlock; ++i) {
              float& value = values_[corner(i, j, k)];
              const bool border = std::min({i, j, k}) == 0 || std::max({i, j, k}) == n_;
              if (border) {
                value = kFar;
              } else if (is_near && (value == kUnknown || std::abs(value) == kFar)) {
                value = static_cast<float>(field_(position(i, j, k)));
                if (!std::isfinite(value)) value = kFar;
              } else if (value == kUnknown) {
                value = middle < 0.0 ? -kFar : kFar;
              }
            }
          }
        }
      }
    }
  }
}

void Grid::find_cells() {
  cells_.clear();
  for (int bk = 0; bk < n_; bk += kBlock) {
    for (int bj = 0; bj < n_; bj += kBlock) {
      for (int bi = 0; bi < n_; bi += kBlock) {
        if (!near(bi, bj, bk)) continue;
        for (int k = bk; k < bk + kBlock; ++k) {
          for (int j = bj; j < bj + kBlock; ++j) {
            for (int i = bi; i < bi + kBlock; ++i) {
              const unsigned bits = inside({i, j, k});
              if (bits != 0 && bits != 0xFFU) cells_.push_back({i, j, k});
            }
          }
        }
      }
    }
  }
}

/// Every block that a cell next to this one lies in.
void Grid::mark_around(const std::array<int, 3>& cell) {
  for (int k = std::max(cell[2] - 1, 0); k <= std::min(cell[2] + 1, n_ - 1); ++k)
    for (int j = std::max(cell[1] - 1, 0); j <= std::min(cell[1] + 1, n_ - 1); ++j)
      for (int i = std::max(cell[0] - 1, 0); i <= std::min(cell[0] + 1, n_ - 1); ++i) near(i, j, k) = true;
}

/// Fills corners until no cell is ambiguous. Corners only ever change from outside to inside, so this ends.
void Grid::resolve() {
  for (bool changed = true; changed;) {
    changed = false;
    find_cells();
    for (const auto& cell : cells_) {
      if (!kAmbiguous[inside(cell)]) continue;
      size_t nearest = values_.size();
      for (unsigned c = 0; c < 8; ++c) {
        const size_t at = corner_of(cell, c);
        if (values_[at] < 0.0F) continue;
        if (nearest == values_.size() || values_[at] < values_[nearest]) nearest = at;
      }
      values_[nearest] = -std::min(values_[nearest], static_cast<float>(0.1 * step_)) - 1e-6F;
      mark_around(cell);
      changed = true;
    }
  }
}

/// The mean of where the surface crosses the edges of the cell.
Vec3 Grid::place(const std::array<int, 3>& cell) const {
  Vec3 sum{};
  int count = 0;
  for (unsigned a = 0; a < 8; ++a) {
    for (const unsigned axis : {1U, 2U, 4U}) {
      if ((a & axis) != 0) continue;
      const unsigned b = a | axis;
      const double from = values_[corner_of(cell, a)], to = values_[corner_of(cell, b)];
      if ((from < 0.0) == (to < 0.0)) continue;
      const double t = from / (from - to);
      const auto along = [&](unsigned bit) { return (a & bit) != 0 ? 1.0 : axis == bit ? t : 0.0; };
      sum = sum + Vec3{along(1), along(2), along(4)};
      ++count;
    }
  }
  sum = sum * (1.0 / count);
  return position(cell[0] + sum.x, cell[1] + sum.y, cell[2] + sum.z);
}

/// Newton's steps along the gradient; back to the start where they lead out of the cell's neighbourhood.
Vec3 Grid::project(const Vec3& start) const {
  const double e = 0.02 * step_;
  Vec3 p = start;
  for (int i = 0; i < 3; ++i) {
    const double f = field_(p);
    if (std::abs(f) < 1e-4 * step_) break;
    const Vec3 g{(field_({p.x + e, p.y, p.z}) - f) / e, (field_({p.x, p.y + e, p.z}) - f) / e,
                 (field_({p.x, p.y, p.z + e}) - f) / e};
    const double g2 = dot(g, g);
    if (!(g2 > 0.01)) return start;
    p = p - g * (f / g2);
  }
  const Vec3 way = p - start;
  return dot(way, way) <= 0.36 * step_ * step_ ? p : start;
}

Surface Grid::extract() {
  sample();
  resolve();
  Surface surface;
  std::vector<uint32_t> vertex(static_cast<size_t>(n_) * static_cast<size_t>(n_) * static_cast<size_t>(n_));
  for (const auto& cell : cells_) {
    vertex[number(cell)] = static_cast<uint32_t>(surface.points.size());
    surface.points.push_back(project(place(cell)));
  }
  for (const auto& cell : cells_) {
    const bool low = values_[corner_of(cell, 0)] < 0.0F;
    for (size_t axis = 0; axis < 3; ++axis) {
      const bool high = values_[corner_of(cell, 1U << axis)] < 0.0F;
      if (low == high) continue;
      // A quad across this edge, through the four cells around it.
      const auto around = [&](int b, int c) {
        std::array<int, 3> other = cell;
        other[(axis + 1) % 3] -= b;
        other[(axis + 2) % 3] -= c;
        return vertex[number(other)];
      };
      std::array<uint32_t, 4> quad{around(1, 1), around(0, 1), around(0, 0), around(1, 0)};
      if (high) std::swap(quad[1], quad[3]);
      const auto length2 = [&](size_t i, size_t j) {
        const Vec3 d = surface.points[quad[i]] - surface.points[quad[j]];
        return dot(d, d);
      };
      const size_t turn = length2(0, 2) <= length2(1, 3) ? 0 : 1;
      surface.triangles.push_back({quad[turn], quad[turn + 1], quad[turn + 2]});
      surface.triangles.push_back({quad[turn], quad[turn + 2], quad[(turn + 3) % 4]});
    }
  }
  return surface;
}

}  // namespace

Surface extract_isosurface(const Field& field, double half, int cells) {
  return Grid(field, half, cells).extract();
}

}  // namespace opaline::render
