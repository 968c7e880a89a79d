// The gradient of the weight by Winograd's algorithm.
#include <algorithm>

#include "core/kernels/scratch.h"
#include "core/kernels/tile.h"
#include "core/kernels/winograd.h"
#include "core/kernels/winograd_tiling.h"
#include "core/parallel.h"

namespace opaline::kernels {
namespace {

/// The gradient of the weight in the transformed domain: for each frequency out x in sums over tiles of the
/// transformed gradient times the transformed input.
template <class T>
class WeightSums {
 public:
  WeightSums(const WinogradKernels<T>& k, const ConvShape& s, Parts<const T> x, const T* dy,
             const ConvSites& sites, int64_t block)
      : k_(k),
        s_(s),
        blocks_(k, s.kernel_h, s.in),
        x_(sources(blocks_, images(s, x, sites.x), s.padding)),
        dy_{s.output(dy, sites.y), 0, 0, 0},
        grid_(k.outputs, s.n, s.out_h(), s.out_w(), sites.y),
        rows_(std::max(k.lanes, tiles<T>().rows)),
        width_(2 * k.lanes),
        frequencies_(k.tile * k.tile),
        a_{block * round_up(s.out, rows_) + k.lanes, block * rows_, rows_},
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
    transform_tiles(dy_, grid_, first, count, k_.outputs, patch.data(), a + slot * rows_, rows_,
                    [&](const T* const* d, int64_t pixel_stride, T* to) {
                      k_.output_gradient(d, pixel_stride, s_.out, to, a_);
                    });
  }

  /// Where the sums of a range of outputs and of inputs lie, next to each other.
  struct Sums {
    T* data;
    int64_t frequency, output;  ///< from one to the next
    int64_t first_output, last_output, first_input, last_input;
  };
  /// All sums, in one array.
  Sums all(T* data) const { return {data, sums_frequency(), blocks_.total(), 0, s_.out, 0, blocks_.total()}; }

  /// sums (+)= products of the first `count` tiles of a block, for a frequency and the inputs of a panel, all
  /// of which are among those of `sums`.
  void multiply(int64_t f, int64_t panel, int64_t count, const T* a, const T* b, bool accumulate,
                const Sums& sums) const {
    const Tiles<T>& gemm = tiles<T>();
    OuterTile<T> t;
    t.a_stride = rows_;
    t.b_stride = width_;
    t.c_stride = sums.output;
    t.columns = std::min(width_, blocks_.total() - panel * width_);
    constexpr int64_t kPiece = 128;  // tiles whose panel stays in the innermost cache
    for (int64_t first = 0; first < count; first += kPiece) {
      t.b = b + f * b_.frequency + panel * b_.panel + first * width_;
      t.pixels = std::min(kPiece, count - first);
      t.accumulate = accumulate || first > 0;
      for (int64_t o = sums.first_output; o < sums.last_output; o += gemm.rows) {
        t.a = a + f * a_.frequency + o / rows_ * a_.panel + o % rows_ + first * rows_;
        t.rows = std::min(gemm.rows, sums.last_output - o);
        t.c = sums.data + f * sums.frequency + (o - sums.first_output) * sums.output + panel * width_ -
              sums.first_input;
        gemm.outer(t);
      }
    }
  }

  /// The taps' gradient from the sums, for an output; `filters` has room for as many as a vector has lanes.
  void finish(const Sums& sums, int64_t o, T* filters, T* dweight) const {
    const int64_t kernel = s_.kernel_h * s_.kernel_w, taps = k_.taps * k_.taps;
    for (int64_t input = sums.first_input; input < sums.last_input; input += k_.lanes) {
      const int64_t block = input / blocks_.channels, i = input % blocks_.channels;
      const int64_t count = std::min(k_.lanes, s_.in - i);
      if (count <= 0) continue;
      const T* const from = sums.data + (o - sums.first_output) * sums.output + input - sums.first_input;
      T* const to = dweight + (o * s_.in + i) * kernel;
      const bool whole = kernel == taps;
      k_.weight_gradient(from, sums.frequency, count, whole ? to : filters, taps);
      for (int64_t t = 0; t < taps && !whole; ++t) {
        const int64_t tap = blocks_.tap(block, t);
        if (tap < 0) continue;
        for (int64_t j = 0; j < count; ++j) to[j * kernel + tap] = filters[j * taps + t];
      }
    }
  }
  void finish(const Sums& sums, T* dweight) const {
    parallel_blocks(s_.out, 4, [&](int64_t first, int64_t last) {
      const Scratch<T> filters(filters_size());
      for (int64_t o = first; o < last; ++o) finish(sums, o, filters.data(), dweight);
    });
  }

  /// The taps' gradient of the first `count` tiles of a block: squares of channels are summed over all
  /// frequencies and turned at once, so that sums never leave the core that makes them.
  void multiply_and_finish(int64_t count, const T* a, const T* b, T* dweight) const {
    constexpr int64_t kSumBytes = 256 << 10;
    const int64_t most = kSumBytes / (frequencies_ * width_ * static_cast<int64_t>(sizeof(T)));
    const int64_t outputs = std::max(most / rows_, int64_t{1}) * rows_;
    const int64_t units = (s_.out + outputs - 1) / outputs;
    parallel_for(panels() * units, [&](int64_t unit) {
      const int64_t panel = unit / units, first = unit % units * outputs;
      const int64_t last = std::min(first + outputs, s_.out);
      const int64_t frequency = (last - first) * width_ + k_.lanes;
      const Scratch<T> values(frequencies_ * frequency), filters(filters_size());
      const Sums sums{values.data(),
                      frequency,
                      width_,
                      first,
                      last,
                      panel * width_,
                      std::min((panel + 1) * width_, blocks_.total())};
      for (int64_t f = 0; f < frequencies_; ++f) multiply(f, panel, count, a, b, false, sums);
      for (int64_t o = first; o < last; ++o) finish(sums, o, filters.data(), dweight);
    });
  }

 private:
  int64_t filters_size() const { return k_.lanes * k_.taps * k_.taps; }

  const WinogradKernels<T>& k_;
  const ConvShape& s_;
  KernelBlocks blocks_;
  std::vector<Source<T>> x_;
  Source<T> dy_;
  TileGrid grid_;
  int64_t rows_, width_, frequencies_;  // widths of panels: outputs, as many as a tile takes, and inputs
  Frequencies a_, b_;
};

}  // namespace

template <class T>
void winograd_weight_gradient(int outputs, const ConvShape& s, Parts<const T> x, const T* dy, T* dweight,
                              const ConvSites& sites) {
  const WinogradKernels<T>& k = winograd_kernels<T>(outputs);
  const int64_t tile_count = TileGrid(outputs, s.n, s.out_h(), s.out_w(), sites.y).count;
  if (tile_count == 0) {
    std::fill_n(dweight, s.out * s.in * s.kernel_h * s.kernel_w, T{});
    return;
  }
  // Few channels: a group of tiles has sums of its own, which stay near the core with the block that it works
  // on.
  constexpr int64_t kOwnSumsBytes = 640 << 10, kOwnBlock = 32, kGroups = 16, kLeastBlocks = 32;
  const int64_t blocks = (tile_count + kOwnBlock - 1) / kOwnBlock;
  if (blocks >= kLeastBlocks &&
      k.tile * k.tile * s.in * s.out * static_cast<int64_t>(sizeof(T)) <= kOwnSumsBytes) {
    const WeightSums<T> work(k, s, x, dy, sites, kOwnBlock);
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
                          work.all(sums.data() + group * work.sums_size()));
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
    work.finish(work.all(sums.data()), dweight);
    return;
  }
  // Many channels: threads share the sums, each owner of some frequencies, and transform every block
  // together.
  constexpr int64_t kSharedBlock = 256, kTilesPerUnit = 16;
  constexpr int64_t kPerFlush = 32;  // blocks summed in T before double takes over
  const int64_t block = std::min(kSharedBlock, round_up(tile_count, kTilesPerUnit));
  const WeightSums<T> work(k, s, x, dy, sites, block);
  const int64_t count = (tile_count + block - 1) / block;
  const Scratch<T> a(work.a_size()), b(work.b_size());
  const auto transform_block = [&](int64_t first, int64_t tiles) {
    parallel_blocks(tiles, kTilesPerUnit, [&](int64_t begin, int64_t end) {
      work.transform(first + begin, end - begin, begin, a.data(), b.data());
    });
  };
  if (count == 1) {
    transform_block(0, tile_count);
    return work.multiply_and_finish(tile_count, a.data(), b.data(), dweight);
  }
  const Scratch<T> sums(work.sums_size());
  const Scratch<double> total(count > kPerFlush ? work.sums_size() : 0);
  for (int64_t i = 0; i < count; ++i) {
    const int64_t first = i * block, tiles = std::min(block, tile_count - first);
    transform_block(first, tiles);
    parallel_for(work.frequencies() * work.panels(), [&](int64_t unit) {
      work.multiply(unit / work.panels(), unit % work.panels(), tiles, a.data(), b.data(), i % kPerFlush > 0,
                    work.all(sums.data()));
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
  work.finish(work.all(sums.data()), dweight);
}

template void winograd_weight_gradient(int, const ConvShape&, Parts<const float>, const float*, float*,
                                       const ConvSites&);
template void winograd_weight_gradient(int, const ConvShape&, Parts<const double>, const double*, double*,
                                       const ConvSites&);

}  // namespace opaline::kernels
