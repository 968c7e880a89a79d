#include "core/active_sites.h"

#include <algorithm>
#include <limits>

#include "core/error.h"
#include "core/kernels/image.h"

namespace opaline {

ActiveSites::ActiveSites(int64_t n, int64_t h, int64_t w) : n_(n), h_(h), w_(w) {
  if (n < 0 || h < 0 || w < 0 || (n > 0 && h > 0 && w > std::numeric_limits<int32_t>::max() / (n * h))) {
    fail("active sites", "{} images of {} x {} pixels are too many", n, h, w);
  }
}

ActiveSites::ActiveSites(int64_t n, int64_t h, int64_t w, std::span<const uint8_t> active)
    : ActiveSites(n, h, w) {
  number(active);
}

void ActiveSites::number(std::span<const uint8_t> active) {
  if (static_cast<int64_t>(active.size()) != n_ * h_ * w_) {
    fail("active sites", "{} flags for {} images of {} x {}", active.size(), n_, h_, w_);
  }
  index_.resize(active.size());
  first_.assign(1, 0);
  int32_t next = 0;
  for (int64_t image = 0; image < n_; ++image) {
    for (int64_t i = image * h_ * w_; i < (image + 1) * h_ * w_; ++i) {
      index_[static_cast<size_t>(i)] = active[static_cast<size_t>(i)] != 0 ? next++ : -1;
    }
    first_.push_back(next);
  }
  find_rectangles();
}

void ActiveSites::find_rectangles() {
  struct Run {
    int64_t begin, end;
    bool operator==(const Run&) const = default;
  };
  std::vector<Run> runs, before;
  size_t open = 0;  // rectangles from here on reach down to the row before
  for (int64_t image = 0; image < n_; ++image) {
    before.clear();
    for (int64_t row = 0; row < h_; ++row) {
      runs.clear();
      int64_t count = 0;
      for (int64_t column = 0; column < w_; ++column) {
        if (site(image, row, column) < 0) continue;
        if (runs.empty() || runs.back().end != column) runs.push_back({column, column});
        ++runs.back().end;
        ++count;
      }
      if (!runs.empty() && runs == before) {
        for (size_t i = open; i < rectangles_.size(); ++i) ++rectangles_[i].rows;
        continue;
      }
      open = rectangles_.size();
      for (const Run& run : runs) {
        rectangles_.push_back(
            {image, row, run.begin, 1, run.end - run.begin, site(image, row, run.begin), count});
      }
      std::swap(before, runs);
    }
  }
}

bool ActiveSites::operator==(const ActiveSites& other) const {
  return this == &other || (n_ == other.n_ && h_ == other.h_ && w_ == other.w_ && index_ == other.index_);
}

const std::vector<ActiveSites::Tile>& ActiveSites::tiles(int64_t side) const {
  const std::lock_guard lock(mutex_);
  const auto [entry, fresh] = tiles_.try_emplace(side);
  if (!fresh) return entry->second;
  std::vector<uint8_t> occupied(static_cast<size_t>(w_));
  for (int64_t image = 0; image < n_; ++image) {
    for (int64_t row = 0; row < h_;) {
      std::fill(occupied.begin(), occupied.end(), uint8_t{0});
      bool any = false;
      const auto mark = [&](int64_t r) {
        for (int64_t column = 0; column < w_; ++column) {
          if (site(image, r, column) < 0) continue;
          occupied[static_cast<size_t>(column)] = 1;
          any = true;
        }
      };
      mark(row);
      if (!any) {
        ++row;
        continue;
      }
      for (int64_t r = row + 1; r < std::min(row + side, h_); ++r) mark(r);
      for (int64_t column = 0; column < w_;) {
        if (occupied[static_cast<size_t>(column)] == 0) {
          ++column;
          continue;
        }
        entry->second.push_back({image, row, column});
        column += side;
      }
      row += side;
    }
  }
  return entry->second;
}

const std::shared_ptr<const ActiveSites>& ActiveSites::halved() const {
  const std::lock_guard lock(mutex_);
  if (halved_) return halved_;
  if (h_ % 2 != 0 || w_ % 2 != 0) fail("active sites", "{} x {} pixels cannot be halved", h_, w_);
  std::vector<uint8_t> active(static_cast<size_t>(n_ * (h_ / 2) * (w_ / 2)), 0);
  for (int64_t i = 0; i < n_ * h_; ++i) {
    for (int64_t column = 0; column < w_; ++column) {
      if (index_[static_cast<size_t>(i * w_ + column)] < 0) continue;
      active[static_cast<size_t>((i / h_ * (h_ / 2) + i % h_ / 2) * (w_ / 2) + column / 2)] = 1;
    }
  }
  halved_ = std::make_shared<const ActiveSites>(n_, h_ / 2, w_ / 2, active);
  return halved_;
}

ActiveSites ActiveSites::mirrored(int64_t padding) const {
  const int64_t h = h_ + 2 * padding, w = w_ + 2 * padding;
  std::vector<uint8_t> active(static_cast<size_t>(n_ * h * w));
  for (int64_t i = 0; i < n_ * h; ++i) {
    const int64_t row = kernels::reflected(i % h - padding, h_);
    for (int64_t column = 0; column < w; ++column) {
      active[static_cast<size_t>(i * w + column)] =
          site(i / h, row, kernels::reflected(column - padding, w_)) >= 0 ? 1 : 0;
    }
  }
  return {n_, h, w, active};
}

std::shared_ptr<const ActiveSites> support_of(int64_t n, int64_t h, int64_t w, std::span<const uint8_t> mask,
                                              int64_t dilation, int64_t tile) {
  if (tile < 1 || h % tile != 0 || w % tile != 0 || dilation < 0 ||
      static_cast<int64_t>(mask.size()) != n * h * w) {
    fail("support", "{} mask pixels for {} images of {} x {} in tiles of {}, dilation {}", mask.size(), n, h,
         w, tile, dilation);
  }
  const int64_t down = h / tile, across = w / tile;
  std::vector<uint8_t> touched(static_cast<size_t>(n * down * across), 0);
  for (int64_t i = 0; i < n * h; ++i) {
    for (int64_t column = 0; column < w; ++column) {
      if (mask[static_cast<size_t>(i * w + column)] == 0) continue;
      touched[static_cast<size_t>((i / h * down + i % h / tile) * across + column / tile)] = 1;
    }
  }
  const auto near = [&](int64_t image, int64_t row, int64_t column) {
    for (int64_t r = std::max<int64_t>(row - dilation, 0); r <= std::min(row + dilation, down - 1); ++r) {
      for (int64_t c = std::max<int64_t>(column - dilation, 0); c <= std::min(column + dilation, across - 1);
           ++c) {
        if (touched[static_cast<size_t>((image * down + r) * across + c)] != 0) return true;
      }
    }
    return false;
  };
  std::vector<uint8_t> active(static_cast<size_t>(n * h * w), 0);
  for (int64_t i = 0; i < n * down * across; ++i) {
    const int64_t image = i / (down * across), row = i / across % down, column = i % across;
    if (!near(image, row, column)) continue;
    for (int64_t r = row * tile; r < (row + 1) * tile; ++r) {
      std::fill_n(active.begin() + (image * h + r) * w + column * tile, tile, uint8_t{1});
    }
  }
  return std::make_shared<const ActiveSites>(n, h, w, active);
}

}  // namespace opaline
