#include "core/kernels/direct.h"

#include <algorithm>
#include <vector>

#include "core/kernels/panels.h"
#include "core/kernels/scratch.h"
#include "core/kernels/tile.h"
#include "core/parallel.h"

namespace opaline::kernels {
namespace {

/// Where the rows of a tile's output go.
template <class T>
struct OutputView {
  T* data;
  int64_t image_stride, row_stride, pixel_stride;
};

/// y (x.n x out_h x out_w) = correlation of x with the weights; the first kernel's first pixel is (top,
/// left).
template <class T>
void correlate(const Image<T>& x, int64_t top, int64_t left, int64_t stride, const PackedWeights<T>& weights,
               int64_t out_h, int64_t out_w, const OutputView<T>& y) {
  const Tiles<T>& tile = tiles<T>();
  // A unit holds enough pixels to make a panel of weights worth fetching.
  constexpr int64_t kPixelsPerUnit = 256, kRowsPerUnit = 4;
  const int64_t channels = x.channels;
  // Several rows, too, because the rows of the kernel overlap.
  const int64_t unit_rows = std::min(std::max(kPixelsPerUnit / std::max<int64_t>(out_w, 1), kRowsPerUnit),
                                     std::max<int64_t>(out_h, 1));
  const int64_t units_per_image = (out_h + unit_rows - 1) / unit_rows;
  const int64_t in_w = (out_w - 1) * stride + weights.run / std::max<int64_t>(channels, 1);
  const auto in_h = [&](int64_t rows) { return (rows - 1) * stride + weights.kernel_h; };
  parallel_for(x.n * units_per_image, [&](int64_t unit) {
    const int64_t image = unit / units_per_image;
    const int64_t first = unit % units_per_image * unit_rows;
    const int64_t last = std::min(first + unit_rows, out_h);
    const int64_t from = top + first * stride, rows = in_h(last - first);
    // Inside the image its pixels are read in place, else from a copy of the unit's rows with their border.
    const bool inside = x.contains(from, left, rows, in_w);
    const Scratch<T> copy(inside ? 0 : rows * in_w * channels);
    if (!inside) {
      for (int64_t i = 0; i < rows; ++i) {
        x.copy_row(image, from + i, left, in_w, copy.data() + i * in_w * channels);
      }
    }
    const T* const source = inside ? x.pixel(image, from, left) : copy.data();
    const int64_t line = (inside ? x.w : in_w) * channels;
    DotTile<T> t;
    t.a_stride = stride * channels;
    t.a_run_stride = line;
    t.runs = weights.kernel_h;
    t.run = weights.run;
    t.a = source;
    t.a_line = stride * line;
    t.c_line = y.row_stride;
    t.c_stride = y.pixel_stride;
    t.lines = last - first;
    t.rows = out_w;
    for (int64_t p = 0; p < weights.panels; ++p) {
      t.b = weights.panel(p);
      t.bias = weights.has_bias ? weights.bias.data() + p * weights.width : nullptr;
      t.columns = std::min(weights.width, weights.columns - p * weights.width);
      t.c = y.data + image * y.image_stride + first * y.row_stride + p * weights.width;
      tile.dot(t, weights.vectors);
    }
  });
}

}  // namespace

template <class T>
void direct_forward(const ConvShape& s, const T* x, const T* weight, const T* bias, T* y) {
  PackedWeights<T> packed(s.kernel_h, s.kernel_w * s.in, s.out, bias);
  const int64_t taps = s.kernel_h * s.kernel_w;
  packed.fill_filters(weight, s.in, taps, s.in * taps, taps, [&](int64_t tap) { return tap * s.in; });
  correlate(s.input(x), -s.padding, -s.padding, s.stride, packed, s.out_h(), s.out_w(),
            OutputView<T>{y, s.out_h() * s.out_w() * s.out, s.out_w() * s.out, s.out});
}

// Row ih of dx meets row oh of dy through kernel row kh = ih + padding - stride * oh. With q = ih + padding,
// rows of one class c = q mod stride meet the kernel rows c, c + stride, .. and nothing else, so each of the
// stride^2 classes of pixels is a convolution of dy, without the zeros that dilation would multiply.
template <class T>
void direct_input_gradient(const ConvShape& s, const T* dy, const T* weight, const T* bias, T* dx) {
  const int64_t border = s.reflect ? s.padding : 0;
  const int64_t h = s.h + 2 * border, w = s.w + 2 * border, padding = s.padding - border;
  struct Axis {
    int64_t first, count, taps, top;  // first pixel of the class, pixels, kernel taps, first row of dy
  };
  const auto axis = [&](int64_t c, int64_t extent, int64_t kernel) {
    const int64_t first = ((c - padding) % s.stride + s.stride) % s.stride;
    const int64_t taps = c < kernel ? (kernel - c + s.stride - 1) / s.stride : 0;
    return Axis{first, extent > first ? (extent - first + s.stride - 1) / s.stride : 0, taps,
                (first + padding - c) / s.stride - (taps - 1)};
  };
  for (int64_t cy = 0; cy < s.stride; ++cy) {
    for (int64_t cx = 0; cx < s.stride; ++cx) {
      const Axis rows = axis(cy, h, s.kernel_h);
      const Axis columns = axis(cx, w, s.kernel_w);
      if (rows.count == 0 || columns.count == 0) continue;
      const OutputView<T> out{dx + (rows.first * w + columns.first) * s.in, h * w * s.in, s.stride * w * s.in,
                              s.stride * s.in};
      if (rows.taps == 0 || columns.taps == 0) {  // no tap reaches these pixels: the bias alone
        parallel_for(s.n * rows.count, [&](int64_t i) {
          T* to = out.data + i / rows.count * out.image_stride + i % rows.count * out.row_stride;
          for (int64_t x = 0; x < columns.count; ++x, to += out.pixel_stride) {
            for (int64_t j = 0; j < s.in; ++j) to[j] = bias != nullptr ? bias[j] : T{};
          }
        });
        continue;
      }
      PackedWeights<T> packed(rows.taps, columns.taps * s.out, s.in, bias);
      const int64_t taps = s.kernel_h * s.kernel_w;
      packed.fill_filters(weight, s.out, s.in * taps, taps, taps, [&](int64_t tap) -> int64_t {
        const int64_t kh = tap / s.kernel_w - cy, kw = tap % s.kernel_w - cx;
        if (kh < 0 || kh % s.stride != 0 || kw < 0 || kw % s.stride != 0) return -1;
        return ((rows.taps - 1 - kh / s.stride) * columns.taps + columns.taps - 1 - kw / s.stride) * s.out;
      });
      correlate(s.output(dy), rows.top, columns.top, 1, packed, rows.count, columns.count, out);
    }
  }
}

namespace {

/// The pixels of dy, cut into chunks of whole rows or parts of one that stay in the innermost caches, and
/// groups of chunks that are summed apart.
struct PixelChunks {
  static constexpr int64_t kPixels = 128;
  int64_t out_h, out_w, lines, length, across, per_image, count, groups, per_group;

  /// `owners`: units of work without groups.
  PixelChunks(const ConvShape& s, int64_t owners)
      : out_h(s.out_h()),
        out_w(s.out_w()),
        lines(std::clamp<int64_t>(kPixels / std::max<int64_t>(out_w, 1), 1, std::max<int64_t>(out_h, 1))),
        length(std::min(kPixels, out_w)),
        across((out_w + kPixels - 1) / kPixels),
        per_image(across * ((out_h + lines - 1) / lines)),
        count(s.n * per_image) {
    constexpr int64_t kUnits = 16;
    groups = std::clamp<int64_t>((kUnits + owners - 1) / owners, 1, std::max<int64_t>(1, count / 8));
    per_group = (count + groups - 1) / groups;
  }

  struct Chunk {
    int64_t image, row, column, lines, length;
  };
  Chunk operator[](int64_t i) const {
    const int64_t row = i % per_image / across * lines, column = i % across * kPixels;
    return {i / per_image, row, column, std::min(lines, out_h - row), std::min(length, out_w - column)};
  }
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

}  // namespace

// The products of x, shifted by a tap, with dy, summed over pixels: [kernel row][(kernel column, input)] x
// output. A unit owns a block of positions in the first factor, all outputs and a group of pixels. It copies
// what it reads of a chunk, because pixels of many channels would share few sets of the caches.
template <class T>
void direct_weight_gradient(const ConvShape& s, const T* x, const T* dy, T* dweight) {
  const Tiles<T>& tile = tiles<T>();
  const Image<T> image = s.input(x);
  const int64_t run = s.kernel_w * s.in, positions = s.kernel_h * run;
  const int64_t width = s.out <= tile.lanes ? tile.lanes : tile.width();
  const int64_t out = (s.out + width - 1) / width * width;
  constexpr int64_t kPerFlush = 32;  // chunks summed in T before double takes over
  constexpr int64_t kSumBytes = 640 << 10;
  const int64_t fitting = kSumBytes / (out * static_cast<int64_t>(sizeof(T)));
  const int64_t block =
      std::min(fitting > run ? fitting / run * run : std::max<int64_t>(fitting, 256), positions);
  const int64_t blocks = (positions + block - 1) / block;
  const PixelChunks chunks(s, blocks);
  // A kernel row is one run of memory unless that would meet the cache badly; then pixels are kept apart.
  const int64_t pixel = s.in % 32 == 0 ? s.in + 16 : s.in;
  const int64_t sums = positions * s.out;
  const Scratch<double> partial(chunks.groups * sums);
  parallel_for(chunks.groups * blocks, [&](int64_t unit) {
    const int64_t group = unit / blocks;
    const int64_t first = unit % blocks * block, last = std::min(first + block, positions);
    const int64_t first_row = first / run, kernel_rows = (last - 1) / run - first_row + 1;
    const int64_t span = (chunks.length - 1) * s.stride + s.kernel_w;
    const Scratch<T> a(((chunks.lines - 1) * s.stride + kernel_rows) * span * pixel);
    const Scratch<T> b(PixelChunks::kPixels * out), acc((last - first) * out), line(span * s.in);
    double* const total = partial.data() + group * sums + first * s.out;
    const int64_t begin = group * chunks.per_group, end = std::min(chunks.count, begin + chunks.per_group);
    if (begin >= end) std::fill_n(total, (last - first) * s.out, 0.0);
    for (int64_t i = begin; i < end; ++i) {
      const PixelChunks::Chunk chunk = chunks[i];
      const int64_t pixels = chunk.lines * chunk.length;
      const int64_t needed = (chunk.length - 1) * s.stride + s.kernel_w;
      const int64_t left = chunk.column * s.stride - s.padding;
      for (int64_t l = 0; l < (chunk.lines - 1) * s.stride + kernel_rows; ++l) {
        const int64_t row = chunk.row * s.stride + first_row + l - s.padding;
        const bool inside = image.contains(row, left, 1, needed);
        if (!inside) image.copy_row(chunk.image, row, left, needed, line.data());
        const T* const from = inside ? image.pixel(chunk.image, row, left) : line.data();
        T* const to = a.data() + l * span * pixel;
        if (pixel == s.in) {
          std::copy_n(from, needed * s.in, to);
        } else {
          for (int64_t j = 0; j < needed; ++j) std::copy_n(from + j * s.in, s.in, to + j * pixel);
        }
      }
      const T* const gradient =
          dy + ((chunk.image * chunks.out_h + chunk.row) * chunks.out_w + chunk.column) * s.out;
      for (int64_t p = 0; p < out; p += width) {
        const int64_t valid = std::min(width, s.out - p);
        for (int64_t l = 0; l < chunk.lines; ++l) {
          for (int64_t j = 0; j < chunk.length; ++j) {
            T* const to = b.data() + p * pixels + (l * chunk.length + j) * width;
            std::copy_n(gradient + (l * chunks.out_w + j) * s.out + p, valid, to);
            std::fill(to + valid, to + width, T{});
          }
        }
      }
      OuterTile<T> t;
      t.a_line = s.stride * span * pixel;
      t.a_stride = s.stride * pixel;
      t.b_line = chunk.length * width;
      t.b_stride = width;
      t.lines = chunk.lines;
      t.pixels = chunk.length;
      t.c_stride = out;
      t.columns = width;
      t.accumulate = (i - begin) % kPerFlush != 0;
      for (int64_t p = 0; p < out; p += width) {
        t.b = b.data() + p * pixels;
        for (int64_t position = first; position < last; position += t.rows) {
          const int64_t row = position / run, r = position % run;
          t.rows = std::min({tile.rows, last - position, run - r});
          if (pixel != s.in) t.rows = std::min(t.rows, s.in - r % s.in);
          t.a = a.data() + ((row - first_row) * span + r / s.in) * pixel + r % s.in;
          t.c = acc.data() + (position - first) * out + p;
          tile.outer(t);
        }
      }
      const int64_t done = i - begin + 1;
      if (done % kPerFlush == 0 || i + 1 == end) {
        for (int64_t r = 0; r < last - first; ++r) {
          add_to_double(acc.data() + r * out, s.out, done > kPerFlush, total + r * s.out);
        }
      }
    }
  });
  // To out x in x taps, a few inputs and outputs at a time: long pieces to read, and to write.
  constexpr int64_t kInputs = 8, kOutputs = 64;
  const int64_t taps = s.kernel_h * s.kernel_w;
  parallel_blocks(s.in, kInputs, [&](int64_t begin, int64_t end) {
    std::vector<T> turned(static_cast<size_t>(kOutputs * kInputs * taps));
    const int64_t length = (end - begin) * taps;
    for (int64_t o = 0; o < s.out; o += kOutputs) {
      const int64_t count = std::min(kOutputs, s.out - o);
      for (int64_t i = begin; i < end; ++i) {
        for (int64_t tap = 0; tap < taps; ++tap) {
          const double* const from =
              partial.data() + (tap / s.kernel_w * run + tap % s.kernel_w * s.in + i) * s.out + o;
          T* const to = turned.data() + (i - begin) * taps + tap;
          for (int64_t j = 0; j < count; ++j) {
            double sum = from[j];
            for (int64_t g = 1; g < chunks.groups; ++g) sum += from[g * sums + j];
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

template void direct_forward(const ConvShape&, const float*, const float*, const float*, float*);
template void direct_forward(const ConvShape&, const double*, const double*, const double*, double*);
template void direct_input_gradient(const ConvShape&, const float*, const float*, const float*, float*);
template void direct_input_gradient(const ConvShape&, const double*, const double*, const double*, double*);
template void direct_weight_gradient(const ConvShape&, const float*, const float*, float*);
template void direct_weight_gradient(const ConvShape&, const double*, const double*, double*);

}  // namespace opaline::kernels
