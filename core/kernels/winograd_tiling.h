// What the passes of Winograd's convolution share: the tiles of an image, the blocks of a kernel, and tiles
// on their way into the transformed domain.
#pragma once

#include <algorithm>
#include <cstdint>
#include <vector>

#include "core/kernels/conv_plan.h"
#include "core/kernels/image.h"
#include "core/kernels/winograd_tile.h"

namespace opaline::kernels {

inline int64_t round_up(int64_t value, int64_t step) {
  return (value + step - 1) / step * step;
}

/// The tiles that cover n images of rows x columns outputs, or those of them that exist, counted through.
struct TileGrid {
  using Tile = ActiveSites::Tile;
  int64_t outputs, rows, columns, down, across;
  const ActiveSites* sites;
  const std::vector<Tile>* tiles;  ///< null for a regular grid
  int64_t count;

  TileGrid(int64_t outputs_, int64_t n, int64_t rows_, int64_t columns_, const ActiveSites* sites_)
      : outputs(outputs_),
        rows(rows_),
        columns(columns_),
        down((rows + outputs - 1) / outputs),
        across((columns + outputs - 1) / outputs),
        sites(sites_),
        tiles(sites == nullptr ? nullptr : &sites->tiles(outputs)),
        count(tiles == nullptr ? n * down * across : static_cast<int64_t>(tiles->size())) {}

  Tile operator[](int64_t i) const {
    if (tiles != nullptr) return (*tiles)[static_cast<size_t>(i)];
    return {i / (down * across), i / across % down * outputs, i % across * outputs};
  }
};

/// Pixels a side of the largest tile.
constexpr int64_t kMaxTile = 8;

/// How a kernel is cut into blocks of as many taps as a tile takes. Each block meets the image, shifted, as
/// if it were further channels of one image.
struct KernelBlocks {
  int64_t side;      ///< taps a side of the kernel
  int64_t taps;      ///< of a block
  int64_t across;    ///< blocks a side
  int64_t channels;  ///< from a block to the next: whole vectors, where there are several

  template <class T>
  KernelBlocks(const WinogradKernels<T>& k, int64_t side_, int64_t channels_)
      : side(side_),
        taps(k.taps),
        across((side + taps - 1) / taps),
        channels(across > 1 ? round_up(channels_, k.lanes) : channels_) {}

  int64_t count() const { return across * across; }
  int64_t total() const { return count() * channels; }
  /// Tap t of block b, counted through the kernel's; negative where the kernel has none.
  int64_t tap(int64_t b, int64_t t) const {
    const int64_t row = b / across * taps + t / taps, column = b % across * taps + t % taps;
    return row < side && column < side ? row * side + column : -1;
  }
};

/// An image whose tiles become channels from `first` on; their patches begin (row, column) from their first
/// output.
template <class T>
struct Source {
  Image<T> image;
  int64_t first, row, column;
};

/// The sources of a convolution of images next to each other, `reach` pixels up and left of their outputs.
template <class T>
std::vector<Source<T>> sources(const KernelBlocks& blocks, const std::vector<Image<T>>& parts,
                               int64_t reach) {
  std::vector<Source<T>> result;
  for (int64_t b = 0; b < blocks.count(); ++b) {
    int64_t first = b * blocks.channels;
    for (const Image<T>& part : parts) {
      result.push_back(
          {part, first, b / blocks.across * blocks.taps - reach, b % blocks.across * blocks.taps - reach});
      first += part.channels;
    }
  }
  return result;
}

/// Transforms the tiles [begin, begin + count) of a source into slots 0, 1, .. of `to`, each `slot` from the
/// next. Tiles whose pixels all exist are read in place.
template <class T, class Transform>
void transform_tiles(const Source<T>& source, const TileGrid& grid, int64_t begin, int64_t count,
                     int64_t side, T* patch, T* to, int64_t slot, const Transform& transform) {
  const Image<T>& x = source.image;
  for (int64_t i = 0; i < count; ++i) {
    const TileGrid::Tile tile = grid[begin + i];
    const int64_t top = tile.row + source.row, left = tile.column + source.column;
    T* const out = to + i * slot;
    const T* lines[kMaxTile];
    if (!x.lines(tile.image, top, left, side, side, lines)) {
      for (int64_t row = 0; row < side; ++row) {
        T* const line = patch + row * side * x.channels;
        x.copy_row(tile.image, top + row, left, side, line);
        lines[row] = line;
      }
    }
    transform(lines, x.channels, out);
  }
}

/// The same, by the transform of inputs, of all sources; frequencies lie as in `layout`.
template <class T>
void transform_inputs(const WinogradKernels<T>& k, const std::vector<Source<T>>& x, const TileGrid& grid,
                      int64_t begin, int64_t count, T* patch, T* to, int64_t slot, Frequencies layout) {
  for (const Source<T>& source : x) {
    layout.first = source.first;
    transform_tiles(source, grid, begin, count, k.tile, patch, to, slot,
                    [&](const T* const* d, int64_t pixel_stride, T* out) {
                      k.input(d, pixel_stride, source.image.channels, out, layout);
                    });
  }
}

/// The parts of a convolution's input as images; the channels of the widest source.
template <class T>
std::vector<Image<T>> images(const ConvShape& s, Parts<const T> parts, const ActiveSites* sites) {
  std::vector<Image<T>> result;
  for (const Part<const T>& part : parts) {
    result.push_back({part.data, s.n, s.h, s.w, part.channels, s.reflect ? s.padding : 0, sites});
  }
  return result;
}

template <class T>
int64_t widest(const std::vector<Source<T>>& x) {
  int64_t channels = 0;
  for (const Source<T>& source : x) channels = std::max(channels, source.image.channels);
  return channels;
}

}  // namespace opaline::kernels
