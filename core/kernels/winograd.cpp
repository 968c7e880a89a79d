#include "core/kernels/winograd.h"

#include <algorithm>
#include <type_traits>
#include <vector>

#include "core/kernels/image.h"
#include "core/kernels/scratch.h"
#include "core/kernels/tile.h"
#include "core/kernels/transpose.h"
#include "core/kernels/winograd_tile.h"
#include "core/parallel.h"

namespace opaline::kernels {
namespace {

int64_t round_up(int64_t value, int64_t step) {
  return (value + step - 1) / step * step;
}

/// The tiles that cover n images of rows x columns outputs, counted through.
struct TileGrid {
  int64_t outputs, rows, columns, down, across, count;

  TileGrid(int64_t outputs_, int64_t n, int64_t rows_, int64_t columns_)
      : outputs(outputs_),
        rows(rows_),
        columns(columns_),
        down((rows + outputs - 1) / outputs),
        across((columns + outputs - 1) / outputs),
        count(n * down * across) {}

  struct Tile {
    int64_t image, row, column;  ///< of the first output
  };
  Tile operator[](int64_t i) const {
    return {i / (down * across), i / across % down * outputs, i % across * outputs};
  }
  /// The tile's first output in an image of rows x columns.
  template <class T>
  T* pixel(const Part<T>& image, const Tile& tile) const {
    return image.data + ((tile.image * rows + tile.row) * columns + tile.column) * image.channels;
  }
};

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

/// The filters of a convolution from `in` to `out` channels in memory, with the distances of neighbouring
/// inputs and outputs.
template <class T>
struct FilterTaps {
  KernelBlocks blocks;
  const T* weight;
  int64_t in, out, in_stride, out_stride;
  bool backwards;  ///< turned by half a circle
};

/// Transformed filters: for each frequency panels of `width` outputs, each [padded inputs][width], zero
/// beyond the last of both.
template <class T>
struct Filters {
  const WinogradKernels<T>& k;
  int64_t in, width, panels, frequency;
  Scratch<T> values;

  Filters(const WinogradKernels<T>& kernels, const FilterTaps<T>& taps, int64_t panels_)
      : k(kernels),
        in(round_up(taps.blocks.total(), k.lanes)),
        width(2 * k.lanes),
        panels(panels_),
        frequency(panels * in * width + k.lanes),
        values(k.tile * k.tile * frequency) {}

  /// Transforms the inputs [begin, end) for the outputs from `output` on into panel `p`.
  void fill(const FilterTaps<T>& taps, int64_t output, int64_t p, int64_t begin, int64_t end) const {
    const KernelBlocks& blocks = taps.blocks;
    const int64_t kernel = blocks.side * blocks.side, valid = std::min(width, taps.out - output);
    const Scratch<T> filters((kernel + 1) * width);
    const T* const zeros = filters.data() + kernel * width;
    std::fill_n(filters.data() + kernel * width, width, T{});
    std::vector<const T*> at(static_cast<size_t>(k.taps * k.taps));
    for (int64_t i = begin; i < end; ++i) {
      const int64_t block = i / blocks.channels, channel = i % blocks.channels;
      const bool exists = block < blocks.count() && channel < taps.in;
      if (exists) {
        transpose(taps.weight + channel * taps.in_stride + output * taps.out_stride, taps.out_stride, valid,
                  kernel, filters.data(), width, width);
      }
      for (int64_t t = 0; t < k.taps * k.taps; ++t) {
        const int64_t tap = exists ? blocks.tap(block, t) : -1;
        at[static_cast<size_t>(t)] =
            tap < 0 ? zeros : filters.data() + (taps.backwards ? kernel - 1 - tap : tap) * width;
      }
      for (int64_t j = 0; j < width; j += k.lanes) {
        k.weight(at.data(), j, values.data() + (p * in + i) * width + j, frequency);
      }
    }
  }
};

/// Transforms the tiles [begin, begin + count) of a source into slots 0, 1, .. of `to`, each `slot` from the
/// next. What lies in the image is read in place.
template <class T, class Transform>
void transform_tiles(const Source<T>& source, const TileGrid& grid, int64_t begin, int64_t count,
                     int64_t side, T* patch, T* to, int64_t slot, const Transform& transform) {
  const Image<T>& x = source.image;
  for (int64_t i = 0; i < count; ++i) {
    const TileGrid::Tile tile = grid[begin + i];
    const int64_t top = tile.row + source.row, left = tile.column + source.column;
    T* const out = to + i * slot;
    if (x.contains(top, left, side, side)) {
      transform(x.pixel(tile.image, top, left), x.w * x.channels, x.channels, out);
      continue;
    }
    for (int64_t row = 0; row < side; ++row) {
      x.copy_row(tile.image, top + row, left, side, patch + row * side * x.channels);
    }
    transform(patch, side * x.channels, x.channels, out);
  }
}

/// The same, by the transform of inputs, of all sources; frequencies lie as in `layout`.
template <class T>
void transform_inputs(const WinogradKernels<T>& k, const std::vector<Source<T>>& x, const TileGrid& grid,
                      int64_t begin, int64_t count, T* patch, T* to, int64_t slot, Frequencies layout) {
  for (const Source<T>& source : x) {
    layout.first = source.first;
    transform_tiles(source, grid, begin, count, k.tile, patch, to, slot,
                    [&](const T* d, int64_t row_stride, int64_t pixel_stride, T* out) {
                      k.input(d, row_stride, pixel_stride, source.image.channels, out, layout);
                    });
  }
}

/// The parts of a convolution's input as images; the channels of the widest source.
template <class T>
std::vector<Image<T>> images(const ConvShape& s, Parts<const T> parts) {
  std::vector<Image<T>> result;
  for (const Part<const T>& part : parts) {
    result.push_back({part.data, s.n, s.h, s.w, part.channels, s.reflect ? s.padding : 0});
  }
  return result;
}

template <class T>
int64_t widest(const std::vector<Source<T>>& x) {
  int64_t channels = 0;
  for (const Source<T>& source : x) channels = std::max(channels, source.image.channels);
  return channels;
}

/// Tiles of a block: as many as keep its transformed values near the core, and more where the filters are too
/// large for the shared cache and every block fetches them from memory.
int64_t tiles_per_block(int64_t bytes_per_tile, int64_t filter_bytes) {
  constexpr int64_t kBytes = int64_t{3} << 19, kLargeFilters = int64_t{3} << 23;
  const int64_t least = filter_bytes > kLargeFilters ? 64 : 32;
  return std::clamp<int64_t>(kBytes / bytes_per_tile / 8 * 8, least, 128);
}

template <class T>
int64_t panels_of(const WinogradKernels<T>& k, int64_t channels) {
  return (channels + 2 * k.lanes - 1) / (2 * k.lanes);
}

/// The bias, zeros beyond it up to whole panels; null where there is none.
template <class T>
std::vector<T> padded(const T* bias, int64_t out, int64_t width) {
  if (bias == nullptr) return {};
  std::vector<T> values(static_cast<size_t>(width));
  std::copy_n(bias, out, values.begin());
  return values;
}

/// y = correlation of x with the filters; parts of y without data are left out. Every block of tiles meets
/// all filters, which are transformed once: for large images.
template <class T>
void convolve_by_tiles(const WinogradKernels<T>& k, const std::vector<Source<T>>& x,
                       const FilterTaps<T>& taps, const T* bias, const TileGrid& grid, Parts<T> y) {
  const Tiles<T>& gemm = tiles<T>();
  const Filters<T> filters(k, taps, panels_of(k, taps.out));
  constexpr int64_t kInputsPerUnit = 8;
  const int64_t units = (filters.in + kInputsPerUnit - 1) / kInputsPerUnit;
  parallel_for(filters.panels * units, [&](int64_t unit) {
    const int64_t p = unit / units, begin = unit % units * kInputsPerUnit;
    filters.fill(taps, p * filters.width, p, begin, std::min(filters.in, begin + kInputsPerUnit));
  });
  const int64_t frequencies = k.tile * k.tile;
  const int64_t out_width = filters.panels * filters.width;
  const std::vector<T> offsets = padded(bias, taps.out, out_width);
  const int64_t block =
      tiles_per_block(frequencies * (filters.in + out_width) * static_cast<int64_t>(sizeof(T)),
                      frequencies * filters.frequency * static_cast<int64_t>(sizeof(T)));
  parallel_for((grid.count + block - 1) / block, [&](int64_t unit) {
    const int64_t begin = unit * block, count = std::min(block, grid.count - begin);
    const Frequencies in_layout{block * filters.in + k.lanes, block * k.lanes, k.lanes};
    const Frequencies out_layout{block * out_width + k.lanes, block * filters.width, filters.width};
    const Scratch<T> in(frequencies * in_layout.frequency), product(frequencies * out_layout.frequency);
    const Scratch<T> patch(k.tile * k.tile * widest(x));
    // [frequency][group of lanes channels][tile][lane], so that both transforms and products run through
    // memory in order.
    transform_inputs(k, x, grid, begin, count, patch.data(), in.data(), k.lanes, in_layout);
    DotTile<T> t;
    t.a_stride = k.lanes;
    t.a_run_stride = block * k.lanes;
    t.runs = filters.in / k.lanes;
    t.run = k.lanes;
    t.c_stride = filters.width;
    t.columns = filters.width;
    for (int64_t f = 0; f < frequencies; ++f) {
      for (int64_t p = 0; p < filters.panels; ++p) {
        t.b = filters.values.data() + f * filters.frequency + p * filters.in * filters.width;
        t.rows = count;
        t.a = in.data() + f * in_layout.frequency;
        t.c = product.data() + f * out_layout.frequency + p * out_layout.panel;
        gemm.dot(t, 2);
      }
    }
    Frequencies at = out_layout;
    for (const Part<T>& part : y) {
      for (int64_t i = 0; part.data != nullptr && i < count; ++i) {
        const TileGrid::Tile tile = grid[begin + i];
        k.output(product.data() + i * filters.width, at, part.channels,
                 bias != nullptr ? offsets.data() + at.first : nullptr, grid.pixel(part, tile),
                 grid.columns * part.channels, part.channels, std::min(k.outputs, grid.rows - tile.row),
                 std::min(k.outputs, grid.columns - tile.column));
      }
      at.first += part.channels;
    }
  });
}

/// The same, where every group of output channels meets all tiles: for small images of many channels, whose
/// transformed filters are larger than all else and so never leave the cache.
template <class T>
void convolve_by_channels(const WinogradKernels<T>& k, const std::vector<Source<T>>& x,
                          const FilterTaps<T>& taps, const T* bias, const TileGrid& grid, Parts<T> y) {
  const Tiles<T>& gemm = tiles<T>();
  constexpr int64_t kTilesPerUnit = 8;
  const int64_t frequencies = k.tile * k.tile, in = round_up(taps.blocks.total(), k.lanes);
  const Frequencies in_layout{grid.count * in + k.lanes, grid.count * k.lanes, k.lanes};
  const Scratch<T> transformed(frequencies * in_layout.frequency);
  parallel_blocks(grid.count, kTilesPerUnit, [&](int64_t begin, int64_t end) {
    const Scratch<T> patch(k.tile * k.tile * widest(x));
    transform_inputs(k, x, grid, begin, end - begin, patch.data(), transformed.data() + begin * k.lanes,
                     k.lanes, in_layout);
  });
  const int64_t panels = panels_of(k, taps.out);
  const std::vector<T> offsets = padded(bias, taps.out, panels * 2 * k.lanes);
  parallel_blocks(panels, 1, [&](int64_t first, int64_t last) {
    const Filters<T> filters(k, taps, last - first);
    const int64_t group = first * filters.width, group_end = last * filters.width;
    const Frequencies out_layout{grid.count * (group_end - group) + k.lanes, grid.count * filters.width,
                                 filters.width};
    const Scratch<T> product(frequencies * out_layout.frequency);
    for (int64_t p = first; p < last; ++p) filters.fill(taps, p * filters.width, p - first, 0, in);
    DotTile<T> t;
    t.a_stride = k.lanes;
    t.a_run_stride = in_layout.panel;
    t.runs = in / k.lanes;
    t.run = k.lanes;
    t.c_stride = filters.width;
    t.columns = filters.width;
    t.rows = grid.count;
    for (int64_t f = 0; f < frequencies; ++f) {
      for (int64_t p = 0; p < filters.panels; ++p) {
        t.a = transformed.data() + f * in_layout.frequency;
        t.b = filters.values.data() + f * filters.frequency + p * in * filters.width;
        t.c = product.data() + f * out_layout.frequency + p * out_layout.panel;
        gemm.dot(t, 2);
      }
    }
    int64_t begin = 0;  // of the part
    for (const Part<T>& part : y) {
      const int64_t from = std::max(begin, group), to = std::min(begin + part.channels, group_end);
      Frequencies at = out_layout;
      at.first = from - group;
      for (int64_t i = 0; part.data != nullptr && from < to && i < grid.count; ++i) {
        const TileGrid::Tile tile = grid[i];
        k.output(product.data() + i * filters.width, at, to - from,
                 bias != nullptr ? offsets.data() + from : nullptr, grid.pixel(part, tile) + (from - begin),
                 grid.columns * part.channels, part.channels, std::min(k.outputs, grid.rows - tile.row),
                 std::min(k.outputs, grid.columns - tile.column));
      }
      begin += part.channels;
    }
  });
}

template <class T>
void convolve(const WinogradKernels<T>& k, const std::vector<Source<T>>& x, const FilterTaps<T>& taps,
              const T* bias, int64_t rows, int64_t columns, Parts<T> y) {
  const TileGrid grid(k.outputs, x.front().image.n, rows, columns);
  // By channels where the tiles take less memory than the filters, and there is enough for several threads.
  constexpr int64_t kLeastPanels = 8, kMostTiles = 512;
  const bool few = grid.count <= std::min(kMostTiles, taps.out) && panels_of(k, taps.out) >= kLeastPanels;
  (few ? convolve_by_channels<T> : convolve_by_tiles<T>)(k, x, taps, bias, grid, y);
}

}  // namespace

template <class T>
bool winograd_takes(Parts<T> parts) {
  return std::all_of(parts.begin(), parts.end() - 1, [](const Part<T>& part) {
    return part.channels % tiles<std::remove_const_t<T>>().lanes == 0;
  });
}

template <class T>
void winograd_forward(int outputs, const ConvShape& s, Parts<const T> x, const T* weight, const T* bias,
                      T* y) {
  const WinogradKernels<T>& k = winograd_kernels<T>(outputs);
  const KernelBlocks blocks(k, s.kernel_h, s.in);
  const int64_t kernel = s.kernel_h * s.kernel_w;
  const Part<T> whole{y, s.out};
  convolve(k, sources(blocks, images(s, x), s.padding),
           FilterTaps<T>{blocks, weight, s.in, s.out, kernel, kernel * s.in, false}, bias, s.out_h(),
           s.out_w(), Parts<T>(&whole, 1));
}

template <class T>
void winograd_input_gradient(int outputs, const ConvShape& s, const T* dy, const T* weight, const T* bias,
                             Parts<T> dx) {
  const WinogradKernels<T>& k = winograd_kernels<T>(outputs);
  const int64_t border = s.reflect ? s.padding : 0;
  const KernelBlocks blocks(k, s.kernel_h, s.out);
  const int64_t kernel = s.kernel_h * s.kernel_w;
  convolve(k, sources(blocks, std::vector<Image<T>>{s.output(dy)}, s.kernel_h - 1 - s.padding + border),
           FilterTaps<T>{blocks, weight, s.out, s.in, kernel * s.in, kernel, true}, bias, s.h + 2 * border,
           s.w + 2 * border, dx);
}

namespace {

/// The gradient of the weight in the transformed domain: for each frequency out x in sums over tiles of the
/// transformed gradient times the transformed input.
template <class T>
class WeightSums {
 public:
  WeightSums(const WinogradKernels<T>& k, const ConvShape& s, Parts<const T> x, const T* dy, int64_t block)
      : k_(k),
        s_(s),
        blocks_(k, s.kernel_h, s.in),
        x_(sources(blocks_, images(s, x), s.padding)),
        dy_{s.output(dy), 0, 0, 0},
        grid_(k.outputs, s.n, s.out_h(), s.out_w()),
        width_(2 * k.lanes),
        frequencies_(k.tile * k.tile),
        a_{block * round_up(s.out, k.lanes) + k.lanes, block * k.lanes, k.lanes},
        b_{block * round_up(blocks_.total(), width_) + k.lanes, block * width_, width_} {}

  const TileGrid& grid() const { return grid_; }
  int64_t frequencies() const { return frequencies_; }
  /// Elements of the transformed gradients (a) and inputs (b) of a block, and of the sums.
  int64_t a_size() const { return frequencies_ * a_.frequency; }
  int64_t b_size() const { return frequencies_ * b_.frequency; }
  int64_t sums_size() const { return frequencies_ * sums_frequency(); }
  int64_t sums_frequency() const { return s_.out * blocks_.total() + k_.lanes; }
  int64_t panels() const { return (blocks_.total() + width_ - 1) / width_; }

  /// Tiles [first, first + count) of the grid into the slots from `slot` on.
  void transform(int64_t first, int64_t count, int64_t slot, T* a, T* b) const {
    const Scratch<T> patch(k_.tile * k_.tile * std::max(widest(x_), s_.out));
    transform_inputs(k_, x_, grid_, first, count, patch.data(), b + slot * width_, width_, b_);
    transform_tiles(dy_, grid_, first, count, k_.outputs, patch.data(), a + slot * k_.lanes, k_.lanes,
                    [&](const T* d, int64_t row_stride, int64_t pixel_stride, T* to) {
                      k_.output_gradient(d, row_stride, pixel_stride, s_.out, to, a_);
                    });
  }

  /// sums (+)= products of the first `count` tiles of a block, for a frequency and a panel of inputs.
  void multiply(int64_t f, int64_t panel, int64_t count, const T* a, const T* b, bool accumulate,
                T* sums) const {
    const Tiles<T>& gemm = tiles<T>();
    OuterTile<T> t;
    t.a_stride = k_.lanes;
    t.b_stride = width_;
    t.c_stride = blocks_.total();
    t.columns = std::min(width_, blocks_.total() - panel * width_);
    constexpr int64_t kPiece = 128;  // tiles whose panel stays in the innermost cache
    for (int64_t first = 0; first < count; first += kPiece) {
      t.b = b + f * b_.frequency + panel * b_.panel + first * width_;
      t.pixels = std::min(kPiece, count - first);
      t.accumulate = accumulate || first > 0;
      for (int64_t o = 0; o < s_.out; o += gemm.rows) {
        t.a = a + f * a_.frequency + o / k_.lanes * a_.panel + o % k_.lanes + first * k_.lanes;
        t.rows = std::min(gemm.rows, s_.out - o);
        t.c = sums + f * sums_frequency() + o * blocks_.total() + panel * width_;
        gemm.outer(t);
      }
    }
  }

  /// The taps' gradient from the sums.
  void finish(const T* sums, T* dweight) const {
    const int64_t kernel = s_.kernel_h * s_.kernel_w, taps = k_.taps * k_.taps;
    parallel_blocks(s_.out, 4, [&](int64_t first, int64_t last) {
      const Scratch<T> filters(k_.lanes * taps);
      for (int64_t o = first; o < last; ++o) {
        for (int64_t i = 0; i < s_.in; i += k_.lanes) {
          const int64_t count = std::min(k_.lanes, s_.in - i);
          T* const to = dweight + (o * s_.in + i) * kernel;
          for (int64_t block = 0; block < blocks_.count(); ++block) {
            const T* const from = sums + o * blocks_.total() + block * blocks_.channels + i;
            const bool whole = kernel == taps;
            k_.weight_gradient(from, sums_frequency(), count, whole ? to : filters.data(), taps);
            for (int64_t t = 0; t < taps && !whole; ++t) {
              const int64_t tap = blocks_.tap(block, t);
              if (tap < 0) continue;
              for (int64_t j = 0; j < count; ++j) to[j * kernel + tap] = filters.data()[j * taps + t];
            }
          }
        }
      }
    });
  }

 private:
  const WinogradKernels<T>& k_;
  const ConvShape& s_;
  KernelBlocks blocks_;
  std::vector<Source<T>> x_;
  Source<T> dy_;
  TileGrid grid_;
  int64_t width_, frequencies_;
  Frequencies a_, b_;
};

}  // namespace

template <class T>
void winograd_weight_gradient(int outputs, const ConvShape& s, Parts<const T> x, const T* dy, T* dweight) {
  const WinogradKernels<T>& k = winograd_kernels<T>(outputs);
  if (s.n == 0) {
    std::fill_n(dweight, s.out * s.in * s.kernel_h * s.kernel_w, T{});
    return;
  }
  // Few channels: a group of tiles has sums of its own, which stay near the core with the block that it works
  // on.
  constexpr int64_t kOwnSumsBytes = 640 << 10, kOwnBlock = 32, kGroups = 16, kLeastBlocks = 32;
  const int64_t blocks = (TileGrid(outputs, s.n, s.out_h(), s.out_w()).count + kOwnBlock - 1) / kOwnBlock;
  if (blocks >= kLeastBlocks &&
      k.tile * k.tile * s.in * s.out * static_cast<int64_t>(sizeof(T)) <= kOwnSumsBytes) {
    const WeightSums<T> work(k, s, x, dy, kOwnBlock);
    const int64_t per_group = (blocks + kGroups - 1) / kGroups;
    const int64_t groups = (blocks + per_group - 1) / per_group;
    const Scratch<T> sums(groups * work.sums_size());
    parallel_for(groups, [&](int64_t group) {
      const Scratch<T> a(work.a_size()), b(work.b_size());
      for (int64_t block = group * per_group; block < std::min(blocks, (group + 1) * per_group); ++block) {
        const int64_t first = block * kOwnBlock, count = std::min(kOwnBlock, work.grid().count - first);
        work.transform(first, count, 0, a.data(), b.data());
        for (int64_t f = 0; f < work.frequencies(); ++f) {
          for (int64_t p = 0; p < work.panels(); ++p) {
            work.multiply(f, p, count, a.data(), b.data(), block > group * per_group,
                          sums.data() + group * work.sums_size());
          }
        }
      }
    });
    parallel_blocks(work.sums_size(), 1 << 14, [&](int64_t begin, int64_t end) {
      for (int64_t i = begin; i < end; ++i) {
        double total = 0.0;
        for (int64_t g = 0; g < groups; ++g) {
          total += static_cast<double>(sums.data()[g * work.sums_size() + i]);
        }
        sums.data()[i] = static_cast<T>(total);
      }
    });
    work.finish(sums.data(), dweight);
    return;
  }
  // Many channels: threads share the sums, each owner of some frequencies, and transform every block
  // together.
  constexpr int64_t kSharedBlock = 256, kTilesPerUnit = 16;
  constexpr int64_t kPerFlush = 32;  // blocks summed in T before double takes over
  const WeightSums<T> work(k, s, x, dy, kSharedBlock);
  const int64_t count = (work.grid().count + kSharedBlock - 1) / kSharedBlock;
  const Scratch<T> a(work.a_size()), b(work.b_size()), sums(work.sums_size());
  const Scratch<double> total(count > kPerFlush ? work.sums_size() : 0);
  for (int64_t i = 0; i < count; ++i) {
    const int64_t first = i * kSharedBlock, tiles = std::min(kSharedBlock, work.grid().count - first);
    parallel_blocks(tiles, kTilesPerUnit, [&](int64_t begin, int64_t end) {
      work.transform(first + begin, end - begin, begin, a.data(), b.data());
    });
    parallel_for(work.frequencies() * work.panels(), [&](int64_t unit) {
      work.multiply(unit / work.panels(), unit % work.panels(), tiles, a.data(), b.data(), i % kPerFlush > 0,
                    sums.data());
    });
    const bool last = i + 1 == count;
    if (count <= kPerFlush || ((i + 1) % kPerFlush != 0 && !last)) continue;
    parallel_blocks(work.sums_size(), 1 << 14, [&](int64_t begin, int64_t end) {
      for (int64_t j = begin; j < end; ++j) {
        total.data()[j] = (i < kPerFlush ? 0.0 : total.data()[j]) + static_cast<double>(sums.data()[j]);
        if (last) sums.data()[j] = static_cast<T>(total.data()[j]);
      }
    });
  }
  work.finish(sums.data(), dweight);
}

template bool winograd_takes(Parts<float>);
template bool winograd_takes(Parts<const float>);
template bool winograd_takes(Parts<double>);
template bool winograd_takes(Parts<const double>);
template void winograd_forward(int, const ConvShape&, Parts<const float>, const float*, const float*, float*);
template void winograd_forward(int, const ConvShape&, Parts<const double>, const double*, const double*,
                               double*);
template void winograd_input_gradient(int, const ConvShape&, const float*, const float*, const float*,
                                      Parts<float>);
template void winograd_input_gradient(int, const ConvShape&, const double*, const double*, const double*,
                                      Parts<double>);
template void winograd_weight_gradient(int, const ConvShape&, Parts<const float>, const float*, float*);
template void winograd_weight_gradient(int, const ConvShape&, Parts<const double>, const double*, double*);

}  // namespace opaline::kernels
