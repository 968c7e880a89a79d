// The gradient of the weight by direct sums.
#include <algorithm>
#include <vector>

#include "core/kernels/direct.h"
#include "core/kernels/scratch.h"
#include "core/kernels/tile.h"
#include "core/parallel.h"

namespace opaline::kernels {
namespace {

int64_t blocks_of(int64_t count, int64_t block) {
  return (count + block - 1) / block;
}

/// The pixels of dy, cut into chunks of whole rows or parts of one that stay in the innermost caches, and
/// groups of chunks that are summed apart.
struct PixelChunks {
  struct Chunk {
    int64_t image, row, column, lines, length;
    int64_t site, line;  ///< of the first pixel in memory, and from a row to the next
  };
  static constexpr int64_t kPixels = 128;
  std::vector<Chunk> chunks;
  int64_t lines = 1, length = 1;  ///< most of a chunk
  int64_t count, groups, per_group;

  /// `owners`: units of work without groups.
  PixelChunks(const ConvShape& s, const ActiveSites* sites, int64_t owners) {
    const int64_t h = s.out_h(), w = s.out_w();
    if (sites == nullptr) {
      for (int64_t image = 0; image < s.n; ++image) cut({image, 0, 0, h, w, image * h * w, w});
    } else {
      for (const ActiveSites::Rectangle& r : sites->rectangles()) cut(r);
    }
    count = static_cast<int64_t>(chunks.size());
    constexpr int64_t kUnits = 16;
    groups = std::clamp<int64_t>(blocks_of(kUnits, owners), 1, std::max<int64_t>(1, count / 8));
    per_group = blocks_of(count, groups);
  }

  const Chunk& operator[](int64_t i) const { return chunks[static_cast<size_t>(i)]; }

 private:
  void cut(const ActiveSites::Rectangle& r) {
    const int64_t rows =
        std::clamp<int64_t>(kPixels / std::max<int64_t>(r.columns, 1), 1, std::max<int64_t>(r.rows, 1));
    for (int64_t i = 0; i < r.rows; i += rows) {
      for (int64_t j = 0; j < r.columns; j += kPixels) {
        chunks.push_back({r.image, r.row + i, r.column + j, std::min(rows, r.rows - i),
                          std::min(kPixels, r.columns - j), r.site + i * r.line + j, r.line});
        lines = std::max(lines, chunks.back().lines);
        length = std::max(length, chunks.back().length);
      }
    }
  }
};

/// The weights, cut into blocks of input and output channels whose sums stay near the core. The nearer a
/// block is to a square, the less is copied for it.
struct WeightBlocks {
  int64_t in, out, down, across;

  WeightBlocks(const ConvShape& s, int64_t width, int64_t element_bytes) : in(s.in), out(s.out) {
    constexpr int64_t kSumBytes = 640 << 10, kChannels = 32;
    const auto halved = [](int64_t count, int64_t step) {
      return blocks_of(blocks_of(count, 2), step) * step;
    };
    while (s.kernel_h * s.kernel_w * in * out * element_bytes > kSumBytes) {
      if (in > kChannels && (in >= out || out <= width)) {
        in = halved(in, kChannels);
      } else if (out > width) {
        out = halved(out, width);
      } else {
        break;
      }
    }
    down = blocks_of(s.in, in);
    across = blocks_of(s.out, out);
  }
  int64_t count() const { return down * across; }
};

/// to[i] = from[i] or to[i] + from[i], in double.
template <class T>
void add_to_double(const T* from, int64_t count, bool add, double* to) {
  if (add) {
    for (int64_t i = 0; i < count; ++i) to[i] += static_cast<double>(from[i]);
  } else {
    for (int64_t i = 0; i < count; ++i) to[i] = static_cast<double>(from[i]);
  }
}

/// The products of x, shifted by a tap, with dy, summed over pixels: for a block of weights
/// [tap][input] x output. What is read of a chunk is copied, because pixels of many channels would share few
/// sets of the caches.
template <class T>
class WeightBlock {
 public:
  WeightBlock(const ConvShape& s, const Image<T>& x, const T* dy, const PixelChunks& chunks,
              const WeightBlocks& blocks, int64_t block)
      : s_(s),
        x_(x),
        dy_(dy),
        chunks_(chunks),
        first_in_(block / blocks.across * blocks.in),
        first_out_(block % blocks.across * blocks.out),
        in_(std::min(blocks.in, s.in - first_in_)),
        out_(std::min(blocks.out, s.out - first_out_)),
        width_(out_ <= tiles<T>().lanes ? tiles<T>().lanes : tiles<T>().width()),
        padded_out_(blocks_of(out_, width_) * width_),
        // A kernel row is one run of memory unless that would meet the cache badly; then pixels are kept
        // apart.
        pixel_(in_ % 32 == 0 ? in_ + 16 : in_),
        span_((chunks.length - 1) * s.stride + s.kernel_w),
        a_(((chunks.lines - 1) * s.stride + s.kernel_h) * span_ * pixel_),
        b_(PixelChunks::kPixels * padded_out_),
        sums_(positions() * padded_out_) {}

  /// Sums over a group of chunks, into [tap][s.in][s.out] doubles.
  void run(int64_t group, double* total) const {
    constexpr int64_t kPerFlush = 32;  // chunks summed in T before double takes over
    const int64_t begin = group * chunks_.per_group, end = std::min(chunks_.count, begin + chunks_.per_group);
    if (begin >= end) {
      sums_.zero();
      flush(false, total);
    }
    for (int64_t i = begin; i < end; ++i) {
      copy_inputs(chunks_[i]);
      copy_gradients(chunks_[i]);
      multiply(chunks_[i], (i - begin) % kPerFlush != 0);
      const int64_t done = i - begin + 1;
      if (done % kPerFlush == 0 || i + 1 == end) flush(done > kPerFlush, total);
    }
  }

 private:
  int64_t positions() const { return s_.kernel_h * s_.kernel_w * in_; }

  void copy_inputs(const PixelChunks::Chunk& chunk) const {
    const int64_t needed = (chunk.length - 1) * s_.stride + s_.kernel_w;
    const int64_t left = chunk.column * s_.stride - s_.padding;
    for (int64_t l = 0; l < (chunk.lines - 1) * s_.stride + s_.kernel_h; ++l) {
      const int64_t row = chunk.row * s_.stride + l - s_.padding;
      T* to = a_.data() + l * span_ * pixel_;
      if (pixel_ == s_.in) {
        x_.copy_row(chunk.image, row, left, needed, to);
        continue;
      }
      for (int64_t j = 0; j < needed; ++j, to += pixel_) {
        if (const T* const from = x_.find(chunk.image, row, left + j)) {
          std::copy_n(from + first_in_, in_, to);
        } else {
          std::fill_n(to, in_, T{});
        }
      }
    }
  }

  void copy_gradients(const PixelChunks::Chunk& chunk) const {
    const T* const from = dy_ + chunk.site * s_.out + first_out_;
    for (int64_t p = 0; p < padded_out_; p += width_) {
      const int64_t valid = std::min(width_, out_ - p);
      T* to = b_.data() + p * chunk.lines * chunk.length;
      for (int64_t l = 0; l < chunk.lines; ++l) {
        for (int64_t j = 0; j < chunk.length; ++j, to += width_) {
          std::copy_n(from + (l * chunk.line + j) * s_.out + p, valid, to);
          std::fill(to + valid, to + width_, T{});
        }
      }
    }
  }

  void multiply(const PixelChunks::Chunk& chunk, bool accumulate) const {
    const Tiles<T>& tile = tiles<T>();
    const int64_t run = s_.kernel_w * in_;  // positions of a kernel row
    OuterTile<T> t;
    t.a_line = s_.stride * span_ * pixel_;
    t.a_stride = s_.stride * pixel_;
    t.b_line = chunk.length * width_;
    t.b_stride = width_;
    t.lines = chunk.lines;
    t.pixels = chunk.length;
    t.c_stride = padded_out_;
    t.columns = width_;
    t.accumulate = accumulate;
    for (int64_t p = 0; p < padded_out_; p += width_) {
      t.b = b_.data() + p * chunk.lines * chunk.length;
      for (int64_t position = 0; position < positions(); position += t.rows) {
        const int64_t r = position % run;
        t.rows = std::min(tile.rows, run - r);
        if (pixel_ != in_) t.rows = std::min(t.rows, in_ - r % in_);
        t.a = a_.data() + (position / run * span_ + r / in_) * pixel_ + r % in_;
        t.c = sums_.data() + position * padded_out_ + p;
        tile.outer(t);
      }
    }
  }

  void flush(bool add, double* total) const {
    for (int64_t position = 0; position < positions(); ++position) {
      double* const to = total + (position / in_ * s_.in + first_in_ + position % in_) * s_.out + first_out_;
      add_to_double(sums_.data() + position * padded_out_, out_, add, to);
    }
  }

  const ConvShape& s_;
  const Image<T>& x_;
  const T* dy_;
  const PixelChunks& chunks_;
  int64_t first_in_, first_out_, in_, out_, width_, padded_out_, pixel_, span_;
  Scratch<T> a_, b_, sums_;
};

/// dweight = the sum of `groups` times [tap][in][out], as out x in x taps: a few inputs and outputs at a
/// time, for long pieces to read, and to write.
template <class T>
void join(const ConvShape& s, const double* partial, int64_t groups, T* dweight) {
  constexpr int64_t kInputs = 8, kOutputs = 64;
  const int64_t taps = s.kernel_h * s.kernel_w, sums = taps * s.in * s.out;
  parallel_blocks(s.in, kInputs, [&](int64_t begin, int64_t end) {
    std::vector<T> turned(static_cast<size_t>(kOutputs * kInputs * taps));
    const int64_t length = (end - begin) * taps;
    for (int64_t o = 0; o < s.out; o += kOutputs) {
      const int64_t count = std::min(kOutputs, s.out - o);
      for (int64_t i = begin; i < end; ++i) {
        for (int64_t tap = 0; tap < taps; ++tap) {
          const double* const from = partial + (tap * s.in + i) * s.out + o;
          T* const to = turned.data() + (i - begin) * taps + tap;
          for (int64_t j = 0; j < count; ++j) {
            double sum = from[j];
            for (int64_t g = 1; g < groups; ++g) sum += from[g * sums + j];
            to[j * length] = static_cast<T>(sum);
          }
        }
      }
      for (int64_t j = 0; j < count; ++j) {
        std::copy_n(turned.data() + j * length, length, dweight + ((o + j) * s.in + begin) * taps);
      }
    }
  });
}

}  // namespace

template <class T>
void direct_weight_gradient(const ConvShape& s, const T* x, const T* dy, T* dweight, const ConvSites& sites) {
  const Image<T> image = s.input(x, sites.x);
  const WeightBlocks blocks(s, tiles<T>().width(), static_cast<int64_t>(sizeof(T)));
  const PixelChunks chunks(s, sites.y, blocks.count());
  const int64_t sums = s.kernel_h * s.kernel_w * s.in * s.out;
  const Scratch<double> partial(chunks.groups * sums);
  parallel_for(chunks.groups * blocks.count(), [&](int64_t unit) {
    const int64_t group = unit / blocks.count();
    WeightBlock<T>(s, image, dy, chunks, blocks, unit % blocks.count())
        .run(group, partial.data() + group * sums);
  });
  join(s, partial.data(), chunks.groups, dweight);
}

template void direct_weight_gradient(const ConvShape&, const float*, const float*, float*, const ConvSites&);
template void direct_weight_gradient(const ConvShape&, const double*, const double*, double*,
                                     const ConvSites&);

}  // namespace opaline::kernels
