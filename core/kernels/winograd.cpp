#include "core/kernels/winograd.h"

#include <algorithm>
#include <type_traits>
#include <vector>

#include "core/kernels/scratch.h"
#include "core/kernels/tile.h"
#include "core/kernels/transpose.h"
#include "core/kernels/winograd_tiling.h"
#include "core/parallel.h"

namespace opaline::kernels {
namespace {

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
  int64_t in, width, panels, frequencies, frequency;
  Scratch<T> values;

  Filters(const WinogradKernels<T>& kernels, int64_t inputs, int64_t panels_)
      : k(kernels),
        in(round_up(inputs, k.lanes)),
        width(2 * k.lanes),
        panels(panels_),
        frequencies(k.tile * k.tile),
        frequency(panels * in * width + k.lanes),
        values(frequencies * frequency) {}

  const T* panel(int64_t f, int64_t p) const { return values.data() + f * frequency + p * in * width; }

  /// Transforms the inputs [begin, end) for the outputs from `output` on into panel `p`, which begins with
  /// the input `first`.
  void fill(const FilterTaps<T>& taps, int64_t output, int64_t p, int64_t first, int64_t begin,
            int64_t end) const {
    const KernelBlocks& blocks = taps.blocks;
    const int64_t kernel = blocks.side * blocks.side, valid = std::min(width, taps.out - output);
    // Filters of neighbouring inputs that follow each other are turned together: vectors are full.
    const int64_t together = taps.in_stride == kernel ? k.lanes : 1;
    const Scratch<T> filters((together * kernel + 1) * width);
    const T* const zeros = filters.data() + together * kernel * width;
    std::fill_n(filters.data() + together * kernel * width, width, T{});
    std::vector<const T*> at(static_cast<size_t>(k.taps * k.taps));
    int64_t turned = 0, left = 0;  // of the filters in hand
    for (int64_t i = begin; i < end; ++i, ++turned, --left) {
      const int64_t block = i / blocks.channels, channel = i % blocks.channels;
      const bool exists = block < blocks.count() && channel < taps.in;
      if (exists && left <= 0) {
        turned = 0;
        left = std::min({together, taps.in - channel, end - i});
        transpose(taps.weight + channel * taps.in_stride + output * taps.out_stride, taps.out_stride, valid,
                  left * kernel, filters.data(), width, width);
      }
      const T* const filter = filters.data() + turned * kernel * width;
      for (int64_t t = 0; t < k.taps * k.taps; ++t) {
        const int64_t tap = exists ? blocks.tap(block, t) : -1;
        at[static_cast<size_t>(t)] =
            tap < 0 ? zeros : filter + (taps.backwards ? kernel - 1 - tap : tap) * width;
      }
      for (int64_t j = 0; j < width; j += k.lanes) {
        k.weight(at.data(), j, values.data() + (p * in + i - first) * width + j, frequency);
      }
    }
  }
};

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

/// product = transformed tiles times transformed filters, for every frequency, or more of it where the
/// filters begin with an input `first` > 0. `in` and `out` tell where the values of the first tile lie; tiles
/// follow each other.
template <class T>
void multiply(const Filters<T>& filters, int64_t first, int64_t count, int64_t tiles_count,
              const T* transformed, const Frequencies& in, T* product, const Frequencies& out) {
  DotTile<T> t;
  t.a_stride = in.width;
  t.a_run_stride = in.panel;
  t.runs = count / in.width;
  t.accumulate = first > 0;
  t.run = in.width;
  t.c_stride = filters.width;
  t.columns = filters.width;
  t.rows = tiles_count;
  for (int64_t f = 0; f < filters.frequencies; ++f) {
    for (int64_t p = 0; p < filters.panels; ++p) {
      t.a = transformed + f * in.frequency + first / in.width * in.panel;
      t.b = filters.panel(f, p);
      t.c = product + f * out.frequency + p * out.panel;
      tiles<T>().dot(t, 2);
    }
  }
}

/// Where outputs go, and what is added to them.
template <class T>
struct Outputs {
  const WinogradKernels<T>& k;
  const TileGrid& grid;
  Parts<T> y;  ///< parts without data are left out
  std::vector<T> bias;

  /// Transforms `product`, of the tiles [begin, begin + count) and the output channels [first, last), back.
  void write(const T* product, Frequencies at, int64_t begin, int64_t count, int64_t first,
             int64_t last) const {
    const Scratch<T> patch(grid.sites == nullptr ? 0 : k.outputs * k.outputs * (last - first));
    int64_t part_begin = 0;
    for (const Part<T>& part : y) {
      const int64_t from = std::max(part_begin, first), to = std::min(part_begin + part.channels, last);
      at.first = from - first;
      for (int64_t i = 0; part.data != nullptr && from < to && i < count; ++i) {
        const TileGrid::Tile tile = grid[begin + i];
        const T* const values = product + i * at.width;
        const T* const offset = bias.empty() ? nullptr : bias.data() + from;
        const int64_t rows = std::min(k.outputs, grid.rows - tile.row);
        const int64_t columns = std::min(k.outputs, grid.columns - tile.column);
        T* lines[kMaxTile];
        if (find_lines(part, tile, rows, columns, from - part_begin, lines)) {
          k.output(values, at, to - from, offset, lines, part.channels, rows, columns);
          continue;
        }
        const int64_t channels = to - from;
        for (int64_t row = 0; row < rows; ++row) lines[row] = patch.data() + row * k.outputs * channels;
        k.output(values, at, channels, offset, lines, channels, rows, columns);
        for (int64_t row = 0; row < rows; ++row) {
          for (int64_t column = 0; column < columns; ++column) {
            const int64_t site = grid.sites->site(tile.image, tile.row + row, tile.column + column);
            if (site < 0) continue;
            std::copy_n(lines[row] + column * channels, channels,
                        part.data + site * part.channels + from - part_begin);
          }
        }
      }
      part_begin += part.channels;
    }
  }

  /// Where the rows of a tile begin, from a channel on, if all its pixels exist.
  bool find_lines(const Part<T>& part, const TileGrid::Tile& tile, int64_t rows, int64_t columns,
                  int64_t channel, T** lines) const {
    for (int64_t row = 0; row < rows; ++row) {
      int64_t first = (tile.image * grid.rows + tile.row + row) * grid.columns + tile.column;
      if (grid.sites != nullptr) {
        first = grid.sites->site(tile.image, tile.row + row, tile.column);
        const int64_t last = grid.sites->site(tile.image, tile.row + row, tile.column + columns - 1);
        if (first < 0 || last != first + columns - 1) return false;
      }
      lines[row] = part.data + first * part.channels + channel;
    }
    return true;
  }
};

/// Where the frequencies of `tiles` transformed tiles of `channels` lie, in panels of `width`: [frequency]
/// [panel][tile][width], so that transforms and products run through memory in order.
Frequencies layout(int64_t tiles, int64_t channels, int64_t width, int64_t lanes) {
  return {tiles * channels + lanes, tiles * width, width};
}

/// Every block of tiles meets all filters, which are transformed once: for large images.
template <class T>
void convolve_by_tiles(const WinogradKernels<T>& k, const std::vector<Source<T>>& x,
                       const FilterTaps<T>& taps, const Outputs<T>& outputs) {
  const TileGrid& grid = outputs.grid;
  const Filters<T> filters(k, taps.blocks.total(), panels_of(k, taps.out));
  constexpr int64_t kInputsPerUnit = 8;
  const int64_t units = (filters.in + kInputsPerUnit - 1) / kInputsPerUnit;
  parallel_for(filters.panels * units, [&](int64_t unit) {
    const int64_t p = unit / units, begin = unit % units * kInputsPerUnit;
    filters.fill(taps, p * filters.width, p, 0, begin, std::min(filters.in, begin + kInputsPerUnit));
  });
  const int64_t out = filters.panels * filters.width, bytes = static_cast<int64_t>(sizeof(T));
  const int64_t block = std::min(tiles_per_block(filters.frequencies * (filters.in + out) * bytes,
                                                 filters.frequencies * filters.frequency * bytes),
                                 round_up(grid.count, 8));
  const Frequencies from = layout(block, filters.in, k.lanes, k.lanes);
  const Frequencies to = layout(block, out, filters.width, k.lanes);
  parallel_blocks(grid.count, block, [&](int64_t begin, int64_t end) {
    const Scratch<T> in(filters.frequencies * from.frequency), product(filters.frequencies * to.frequency);
    const Scratch<T> patch(k.tile * k.tile * widest(x));
    transform_inputs(k, x, grid, begin, end - begin, patch.data(), in.data(), k.lanes, from);
    multiply(filters, 0, filters.in, end - begin, in.data(), from, product.data(), to);
    outputs.write(product.data(), to, begin, end - begin, 0, taps.out);
  });
}

/// Every panel of output channels meets all tiles: for small images of many channels, whose transformed
/// filters are larger than all else and so never leave the cache.
template <class T>
void convolve_by_channels(const WinogradKernels<T>& k, const std::vector<Source<T>>& x,
                          const FilterTaps<T>& taps, const Outputs<T>& outputs) {
  const TileGrid& grid = outputs.grid;
  constexpr int64_t kTilesPerUnit = 8;
  const int64_t frequencies = k.tile * k.tile, in = round_up(taps.blocks.total(), k.lanes);
  const Frequencies from = layout(grid.count, in, k.lanes, k.lanes);
  const Scratch<T> transformed(frequencies * from.frequency);
  parallel_blocks(grid.count, kTilesPerUnit, [&](int64_t begin, int64_t end) {
    const Scratch<T> patch(k.tile * k.tile * widest(x));
    transform_inputs(k, x, grid, begin, end - begin, patch.data(), transformed.data() + begin * k.lanes,
                     k.lanes, from);
  });
  // Few tiles: filters are met as soon as they are transformed, while they are near the core. More would come
  // from farther than the filters do.
  const int64_t chunk = grid.count < kChain ? std::min(kChain, in) : in;
  parallel_for(panels_of(k, taps.out), [&](int64_t p) {
    const Filters<T> filters(k, chunk, 1);
    const int64_t first = p * filters.width;
    const Frequencies to = layout(grid.count, filters.width, filters.width, k.lanes);
    const Scratch<T> product(frequencies * to.frequency);
    for (int64_t begin = 0; begin < in; begin += chunk) {
      const int64_t end = std::min(begin + chunk, in);
      filters.fill(taps, first, 0, begin, begin, end);
      multiply(filters, begin, end - begin, grid.count, transformed.data(), from, product.data(), to);
    }
    outputs.write(product.data(), to, 0, grid.count, first, std::min(first + filters.width, taps.out));
  });
}

/// y = correlation of x with the filters; parts of y without data are left out.
template <class T>
void convolve(const WinogradKernels<T>& k, const std::vector<Source<T>>& x, const FilterTaps<T>& taps,
              const T* bias, int64_t rows, int64_t columns, Parts<T> y, const ActiveSites* y_sites) {
  const TileGrid grid(k.outputs, x.front().image.n, rows, columns, y_sites);
  if (grid.count == 0) return;
  const Outputs<T> outputs{k, grid, y, padded(bias, taps.out, panels_of(k, taps.out) * 2 * k.lanes)};
  // By channels where the tiles take less memory than the filters, and there is enough for several threads.
  constexpr int64_t kLeastPanels = 8, kMostTiles = 512;
  const bool few = grid.count <= std::min(kMostTiles, taps.out) && panels_of(k, taps.out) >= kLeastPanels;
  (few ? convolve_by_channels<T> : convolve_by_tiles<T>)(k, x, taps, outputs);
}

}  // namespace

template <class T>
bool winograd_takes(Parts<T> parts) {
  return std::all_of(parts.begin(), parts.end() - 1, [](const Part<T>& part) {
    return part.channels % tiles<std::remove_const_t<T>>().lanes == 0;
  });
}

template <class T>
void winograd_forward(int outputs, const ConvShape& s, Parts<const T> x, const T* weight, const T* bias, T* y,
                      const ConvSites& sites) {
  const WinogradKernels<T>& k = winograd_kernels<T>(outputs);
  const KernelBlocks blocks(k, s.kernel_h, s.in);
  const int64_t kernel = s.kernel_h * s.kernel_w;
  const Part<T> whole{y, s.out};
  convolve(k, sources(blocks, images(s, x, sites.x), s.padding),
           FilterTaps<T>{blocks, weight, s.in, s.out, kernel, kernel * s.in, false}, bias, s.out_h(),
           s.out_w(), Parts<T>(&whole, 1), sites.y);
}

template <class T>
void winograd_input_gradient(int outputs, const ConvShape& s, const T* dy, const T* weight, const T* bias,
                             Parts<T> dx, const ConvSites& sites) {
  const WinogradKernels<T>& k = winograd_kernels<T>(outputs);
  const int64_t border = s.reflect ? s.padding : 0;
  const KernelBlocks blocks(k, s.kernel_h, s.out);
  const int64_t kernel = s.kernel_h * s.kernel_w;
  convolve(k,
           sources(blocks, std::vector<Image<T>>{s.output(dy, sites.y)}, s.kernel_h - 1 - s.padding + border),
           FilterTaps<T>{blocks, weight, s.out, s.in, kernel * s.in, kernel, true}, bias, s.h + 2 * border,
           s.w + 2 * border, dx, sites.x);
}

template bool winograd_takes(Parts<float>);
template bool winograd_takes(Parts<const float>);
template bool winograd_takes(Parts<double>);
template bool winograd_takes(Parts<const double>);
template void winograd_forward(int, const ConvShape&, Parts<const float>, const float*, const float*, float*,
                               const ConvSites&);
template void winograd_forward(int, const ConvShape&, Parts<const double>, const double*, const double*,
                               double*, const ConvSites&);
template void winograd_input_gradient(int, const ConvShape&, const float*, const float*, const float*,
                                      Parts<float>, const ConvSites&);
template void winograd_input_gradient(int, const ConvShape&, const double*, const double*, const double*,
                                      Parts<double>, const ConvSites&);

}  // namespace opaline::kernels
