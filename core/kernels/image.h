// Channels-last images as convolutions read them: with a border that is not stored, and pixels that are
// absent.
#pragma once

#include <algorithm>
#include <cstdint>
#include <span>

#include "core/active_sites.h"

namespace opaline::kernels {

/// Source row (or column) of row i of a reflected image: mirrored at the ends, which are not repeated.
/// Needs -size < i < 2 * size - 1.
inline int64_t reflected(int64_t i, int64_t size) {
  if (i < 0) return -i;
  return i < size ? i : 2 * (size - 1) - i;
}

/// n images of h x w x channels. Outside lie zeros, or, for up to `reflect` pixels, the mirrored image. With
/// `sites` memory holds these pixels alone, and the others are zeros.
template <class T>
struct Image {
  const T* data = nullptr;
  int64_t n = 0, h = 0, w = 0, channels = 0;
  int64_t reflect = 0;
  const ActiveSites* sites = nullptr;

  /// A pixel that exists.
  const T* pixel(int64_t image, int64_t row, int64_t column) const {
    return data +
           (sites == nullptr ? (image * h + row) * w + column : sites->site(image, row, column)) * channels;
  }
  bool contains(int64_t top, int64_t left, int64_t rows, int64_t columns) const {
    return top >= 0 && left >= 0 && top + rows <= h && left + columns <= w;
  }

  /// The pixel that stands at (row, column), which may lie outside; null for zeros.
  const T* find(int64_t image, int64_t row, int64_t column) const {
    if (row < -reflect || row >= h + reflect || column < -reflect || column >= w + reflect) return nullptr;
    const int64_t from_row = reflected(row, h), from_column = reflected(column, w);
    if (sites != nullptr && sites->site(image, from_row, from_column) < 0) return nullptr;
    return pixel(image, from_row, from_column);
  }

  /// Where the rows of the pixels [left, left + columns) begin, if all of these exist within the image, and
  /// so follow each other in memory; otherwise false.
  bool lines(int64_t image, int64_t top, int64_t left, int64_t rows, int64_t columns, const T** to) const {
    if (!contains(top, left, rows, columns)) return false;
    if (sites == nullptr) {
      for (int64_t i = 0; i < rows; ++i) to[i] = pixel(image, top + i, left);
      return true;
    }
    for (int64_t i = 0; i < rows; ++i) {
      const int64_t first = sites->site(image, top + i, left);
      if (first < 0 || sites->site(image, top + i, left + columns - 1) != first + columns - 1) return false;
      to[i] = data + first * channels;
    }
    return true;
  }

  /// Copies the pixels of the columns [left, left + columns) of a row to `to`, contiguously.
  void copy_row(int64_t image, int64_t row, int64_t left, int64_t columns, T* to) const {
    const bool mirrored = row < 0 || row >= h;
    if (mirrored && (row < -reflect || row >= h + reflect)) {
      std::fill_n(to, columns * channels, T{});
      return;
    }
    if (sites != nullptr) {
      for (int64_t j = 0; j < columns; ++j) copy_pixel(image, row, left + j, to + j * channels);
      return;
    }
    const int64_t source = mirrored ? reflected(row, h) : row;
    const int64_t first = std::clamp<int64_t>(-left, 0, columns);
    const int64_t last = std::clamp<int64_t>(w - left, first, columns);
    const auto border = [&](int64_t begin, int64_t end) {
      for (int64_t j = begin; j < end; ++j) copy_pixel(image, row, left + j, to + j * channels);
    };
    border(0, first);
    if (last > first) {
      std::copy_n(pixel(image, source, left + first), (last - first) * channels, to + first * channels);
    }
    border(last, columns);
  }

 private:
  void copy_pixel(int64_t image, int64_t row, int64_t column, T* to) const {
    if (const T* const from = find(image, row, column)) {
      std::copy_n(from, channels, to);
    } else {
      std::fill_n(to, channels, T{});
    }
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

/// The pixels of a convolution's input and output that exist; null for all.
struct ConvSites {
  const ActiveSites* x = nullptr;
  const ActiveSites* y = nullptr;
};

}  // namespace opaline::kernels
