// Channels-last images as convolutions read them: with a border that is not stored.
#pragma once

#include <algorithm>
#include <cstdint>
#include <span>

namespace opaline::kernels {

/// Source row (or column) of row i of a reflected image: mirrored at the ends, which are not repeated.
/// Needs -size < i < 2 * size - 1.
inline int64_t reflected(int64_t i, int64_t size) {
  if (i < 0) return -i;
  return i < size ? i : 2 * (size - 1) - i;
}

/// n images of h x w x channels. Outside lie zeros, or, for up to `reflect` pixels, the mirrored image.
template <class T>
struct Image {
  const T* data = nullptr;
  int64_t n = 0, h = 0, w = 0, channels = 0;
  int64_t reflect = 0;

  const T* pixel(int64_t image, int64_t row, int64_t column) const {
    return data + ((image * h + row) * w + column) * channels;
  }
  bool contains(int64_t top, int64_t left, int64_t rows, int64_t columns) const {
    return top >= 0 && left >= 0 && top + rows <= h && left + columns <= w;
  }

  /// The pixel that stands at (row, column), which may lie outside; null for zeros.
  const T* find(int64_t image, int64_t row, int64_t column) const {
    if (row < -reflect || row >= h + reflect || column < -reflect || column >= w + reflect) return nullptr;
    return pixel(image, reflected(row, h), reflected(column, w));
  }

  /// Copies the pixels of the columns [left, left + columns) of a row to `to`, contiguously.
  void copy_row(int64_t image, int64_t row, int64_t left, int64_t columns, T* to) const {
    const bool mirrored = row < 0 || row >= h;
    if (mirrored && (row < -reflect || row >= h + reflect)) {
      std::fill_n(to, columns * channels, T{});
      return;
    }
    const int64_t source = mirrored ? reflected(row, h) : row;
    const int64_t first = std::clamp<int64_t>(-left, 0, columns);
    const int64_t last = std::clamp<int64_t>(w - left, first, columns);
    const auto border = [&](int64_t begin, int64_t end) {
      for (int64_t j = begin; j < end; ++j) {
        if (const T* const from = find(image, row, left + j)) {
          std::copy_n(from, channels, to + j * channels);
        } else {
          std::fill_n(to + j * channels, channels, T{});
        }
      }
    };
    border(0, first);
    if (last > first) {
      std::copy_n(pixel(image, source, left + first), (last - first) * channels, to + first * channels);
    }
    border(last, columns);
  }
};

/// Some channels of an image; several parts one after the other are what a concatenation would make.
template <class T>
struct Part {
  T* data = nullptr;  ///< n x h x w x channels
  int64_t channels = 0;
};
template <class T>
using Parts = std::span<const Part<T>>;

}  // namespace opaline::kernels
