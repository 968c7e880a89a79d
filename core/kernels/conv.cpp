#include "core/kernels/conv.h"

#include <algorithm>
#include <span>
#include <vector>

#include "core/kernels/tile.h"
#include "core/memory.h"
#include "core/parallel.h"

namespace opaline::kernels {
namespace {

/// Scratch memory from the tensor pool: a step asks for the same sizes every time.
template <class T>
class Scratch {
 public:
  explicit Scratch(int64_t count)
      : bytes_(tensor_pool().allocate(count * static_cast<int64_t>(sizeof(T)))), count_(count) {}
  T* data() const { return reinterpret_cast<T*>(bytes_.get()); }
  void zero() const { std::fill_n(data(), count_, T{}); }

 private:
  std::shared_ptr<std::byte> bytes_;
  int64_t count_;
};

/// The weights of a (sub-)convolution as the dot tile wants them: panels of `width` output columns, each
/// [kernel_h][kernel_w * in][width], zero beyond the last column; biases padded alike.
template <class T>
struct PackedWeights {
  int64_t kernel_h, run, columns, vectors, width, panels;
  Scratch<T> values, bias;
  bool has_bias;

  PackedWeights(int64_t kernel_h_, int64_t run_, int64_t columns_, const T* bias_values)
      : kernel_h(kernel_h_),
        run(run_),
        columns(columns_),
        vectors(tiles<T>().vectors_for(columns)),
        width(vectors * tiles<T>().lanes),
        panels((columns + width - 1) / width),
        values(panels * kernel_h * run * width),
        bias(panels * width),
        has_bias(bias_values != nullptr) {
    bias.zero();
    if (has_bias) std::copy_n(bias_values, columns, bias.data());
  }

  const T* panel(int64_t p) const { return values.data() + p * kernel_h * run * width; }

  /// Fills element (row q, position r in the run, column j) with at(q, r, j).
  template <class F>
  void fill(const F& at, bool parallel = true) {
    const auto fill_panel = [&](int64_t p) {
      T* to = values.data() + p * kernel_h * run * width;
      const int64_t valid = std::min(width, columns - p * width);
      for (int64_t q = 0; q < kernel_h; ++q) {
        for (int64_t r = 0; r < run; ++r, to += width) {
          for (int64_t j = 0; j < valid; ++j) to[j] = at(q, r, p * width + j);
          std::fill(to + valid, to + width, T{});
        }
      }
    };
    if (parallel) {
      parallel_for(panels, fill_panel);
    } else {
      for (int64_t p = 0; p < panels; ++p) fill_panel(p);
    }
  }
};

/// Where the rows of a tile's output go.
template <class T>
struct OutputView {
  T* data;
  int64_t image_stride, row_stride, pixel_stride;
};

/// Unpadded convolution of n images (h x w x channels, contiguous) to out_h x out_w pixels.
template <class T>
void convolve(const T* x, int64_t n, int64_t h, int64_t w, int64_t channels, int64_t stride,
              const PackedWeights<T>& weights, int64_t out_h, int64_t out_w, const OutputView<T>& y) {
  const Tiles<T>& tile = tiles<T>();
  // A unit holds enough pixels to make a panel of weights worth fetching.
  constexpr int64_t kPixelsPerUnit = 256;
  const int64_t unit_rows = std::clamp<int64_t>(kPixelsPerUnit / std::max<int64_t>(out_w, 1), 1, out_h);
  const int64_t units_per_image = (out_h + unit_rows - 1) / unit_rows;
  parallel_for(n * units_per_image, [&](int64_t unit) {
    const int64_t image = unit / units_per_image;
    const int64_t first = unit % units_per_image * unit_rows;
    const int64_t last = std::min(first + unit_rows, out_h);
    DotTile<T> t;
    t.a_stride = stride * channels;
    t.a_run_stride = w * channels;
    t.runs = weights.kernel_h;
    t.run = weights.run;
    t.c_stride = y.pixel_stride;
    for (int64_t p = 0; p < weights.panels; ++p) {
      t.b = weights.panel(p);
      t.bias = weights.has_bias ? weights.bias.data() + p * weights.width : nullptr;
      t.columns = std::min(weights.width, weights.columns - p * weights.width);
      for (int64_t row = first; row < last; ++row) {
        const T* const line = x + (image * h + row * stride) * w * channels;
        T* const out = y.data + image * y.image_stride + row * y.row_stride + p * weights.width;
        for (int64_t column = 0; column < out_w; column += tile.rows) {
          t.rows = std::min(tile.rows, out_w - column);
          t.a = line + column * t.a_stride;
          t.c = out + column * y.pixel_stride;
          tile.dot(t, weights.vectors);
        }
      }
    }
  });
}

/// Copies n images of h x w x c into a frame that shows the rows [top, top + out_h) and columns
/// [left, left + out_w) of each, zero outside it.
template <class T>
void copy_window(const T* x, int64_t n, int64_t h, int64_t w, int64_t c, int64_t top, int64_t left,
                 int64_t out_h, int64_t out_w, T* y) {
  const int64_t first = std::clamp<int64_t>(-left, 0, out_w);
  const int64_t last = std::clamp<int64_t>(w - left, first, out_w);
  parallel_blocks(n * out_h, 16, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      const int64_t row = i % out_h + top;
      T* const to = y + i * out_w * c;
      if (row < 0 || row >= h || first == last) {
        std::fill_n(to, out_w * c, T{});
        continue;
      }
      const T* const from = x + ((i / out_h * h + row) * w + left + first) * c;
      std::fill_n(to, first * c, T{});
      std::copy_n(from, (last - first) * c, to + first * c);
      std::fill(to + last * c, to + out_w * c, T{});
    }
  });
}

/// x with a border of zeros; x itself where there is none.
template <class T>
struct Padded {
  Scratch<T> copy;
  const T* data;
  int64_t h, w;

  Padded(const ConvShape& s, const T* x)
      : copy(s.padding == 0 ? 0 : s.n * (s.h + 2 * s.padding) * (s.w + 2 * s.padding) * s.in),
        data(x),
        h(s.h + 2 * s.padding),
        w(s.w + 2 * s.padding) {
    if (s.padding == 0) return;
    copy_window(x, s.n, s.h, s.w, s.in, -s.padding, -s.padding, h, w, copy.data());
    data = copy.data();
  }
};

}  // namespace

template <class T>
void conv_forward(const ConvShape& s, const T* x, const T* weight, const T* bias, T* y) {
  PackedWeights<T> packed(s.kernel_h, s.kernel_w * s.in, s.out, bias);
  packed.fill([&](int64_t q, int64_t r, int64_t j) {
    return weight[((j * s.in + r % s.in) * s.kernel_h + q) * s.kernel_w + r / s.in];
  });
  const Padded<T> padded(s, x);
  convolve(padded.data, s.n, padded.h, padded.w, s.in, s.stride, packed, s.out_h(), s.out_w(),
           {y, s.out_h() * s.out_w() * s.out, s.out_w() * s.out, s.out});
}

// Row ih of dx meets row oh of dy through kernel row kh = ih + padding - stride * oh. With q = ih + padding,
// rows of one class c = q mod stride meet the kernel rows c, c + stride, .. and nothing else, so each of the
// stride^2 classes of pixels is an unpadded convolution of dy, without the zeros that dilation would
// multiply.
template <class T>
void conv_input_gradient(const ConvShape& s, const T* dy, const T* weight, const T* bias, T* dx) {
  const int64_t dy_h = s.out_h(), dy_w = s.out_w();
  struct Axis {
    int64_t first, count, taps, top;  // first pixel of the class, pixels, kernel taps, first row of dy
  };
  const auto axis = [&](int64_t c, int64_t extent, int64_t kernel) {
    const int64_t first = ((c - s.padding) % s.stride + s.stride) % s.stride;
    const int64_t taps = c < kernel ? (kernel - c + s.stride - 1) / s.stride : 0;
    return Axis{first, extent > first ? (extent - first + s.stride - 1) / s.stride : 0, taps,
                (first + s.padding - c) / s.stride - (taps - 1)};
  };
  for (int64_t cy = 0; cy < s.stride; ++cy) {
    for (int64_t cx = 0; cx < s.stride; ++cx) {
      const Axis rows = axis(cy, s.h, s.kernel_h);
      const Axis columns = axis(cx, s.w, s.kernel_w);
      if (rows.count == 0 || columns.count == 0) continue;
      const OutputView<T> out{dx + (rows.first * s.w + columns.first) * s.in, s.h * s.w * s.in,
                              s.stride * s.w * s.in, s.stride * s.in};
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
      packed.fill([&](int64_t q, int64_t r, int64_t j) {
        const int64_t kh = cy + s.stride * (rows.taps - 1 - q);
        const int64_t kw = cx + s.stride * (columns.taps - 1 - r / s.out);
        return weight[((r % s.out * s.in + j) * s.kernel_h + kh) * s.kernel_w + kw];
      });
      const int64_t h = rows.count + rows.taps - 1, w = columns.count + columns.taps - 1;
      const Scratch<T> window(s.n * h * w * s.out);
      copy_window(dy, s.n, dy_h, dy_w, s.out, rows.top, columns.top, h, w, window.data());
      convolve(window.data(), s.n, h, w, s.out, 1, packed, rows.count, columns.count, out);
    }
  }
}

namespace {

/// acc (runs x run x columns, double) += for each kernel row q and position r in its run the products of
/// x[.. + r] and dy, over the images and rows of `units`. Parallel over blocks of (q, r), each with one
/// owner.
template <class T>
void accumulate_outer(const T* x, int64_t h, int64_t w, int64_t channels, int64_t stride, int64_t runs,
                      int64_t run, const T* dy, int64_t n, int64_t out_h, int64_t out_w, int64_t columns,
                      double* acc) {
  const Tiles<T>& tile = tiles<T>();
  constexpr int64_t kPixelsPerChunk = 512;  // register sums in T stay short; then double takes over
  const int64_t chunk_rows = std::clamp<int64_t>(kPixelsPerChunk / std::max<int64_t>(out_w, 1), 1, out_h);
  // Blocks small enough to occupy the threads, large enough to reuse a chunk of dy from cache.
  const int64_t block = std::max(tile.rows, std::min<int64_t>(64, run / 4 / tile.rows * tile.rows));
  const int64_t blocks = (run + block - 1) / block;
  parallel_for(runs * blocks, [&](int64_t unit) {
    const int64_t q = unit / blocks;
    const int64_t first = unit % blocks * block;
    const int64_t last = std::min(first + block, run);
    OuterTile<T> t;
    t.a_line = stride * w * channels;
    t.a_stride = stride * channels;
    t.b_line = out_w * columns;
    t.b_stride = columns;
    t.c_stride = columns;
    for (int64_t image = 0; image < n; ++image) {
      for (int64_t row = 0; row < out_h; row += chunk_rows) {
        t.lines = std::min(chunk_rows, out_h - row);
        for (int64_t begin = 0; begin < out_w; begin += kPixelsPerChunk) {
          t.pixels = std::min(kPixelsPerChunk, out_w - begin);
          const T* const a = x + ((image * h + row * stride + q) * w + begin * stride) * channels;
          const T* const b = dy + ((image * out_h + row) * out_w + begin) * columns;
          for (int64_t r = first; r < last; r += tile.rows) {
            t.a = a + r;
            t.rows = std::min(tile.rows, last - r);
            for (int64_t j = 0; j < columns; j += tile.width()) {
              t.b = b + j;
              t.columns = std::min(tile.width(), columns - j);
              t.c = acc + (q * run + r) * columns + j;
              tile.outer(t);
            }
          }
        }
      }
    }
  });
}

}  // namespace

template <class T>
void conv_weight_gradient(const ConvShape& s, const T* x, const T* dy, T* dweight) {
  const Padded<T> padded(s, x);
  const int64_t run = s.kernel_w * s.in;
  const Scratch<double> acc(s.kernel_h * run * s.out);
  acc.zero();
  accumulate_outer(padded.data, padded.h, padded.w, s.in, s.stride, s.kernel_h, run, dy, s.n, s.out_h(),
                   s.out_w(), s.out, acc.data());
  parallel_blocks(s.out, 16, [&](int64_t begin, int64_t end) {
    for (int64_t i = 0; i < s.in; ++i) {
      for (int64_t q = 0; q < s.kernel_h; ++q) {
        for (int64_t kw = 0; kw < s.kernel_w; ++kw) {
          const double* const from = acc.data() + (q * run + kw * s.in + i) * s.out;
          for (int64_t o = begin; o < end; ++o) {
            dweight[((o * s.in + i) * s.kernel_h + q) * s.kernel_w + kw] = static_cast<T>(from[o]);
          }
        }
      }
    }
  });
}

template <class T>
void column_sums(const T* x, int64_t rows, int64_t columns, double* sums) {
  constexpr int64_t kBlock = 1024;
  const int64_t blocks = (rows + kBlock - 1) / kBlock;
  std::vector<double> partial(static_cast<size_t>(blocks * columns), 0.0);
  parallel_for(blocks, [&](int64_t b) {
    double* const to = partial.data() + b * columns;
    for (int64_t m = b * kBlock; m < std::min(rows, (b + 1) * kBlock); ++m) {
      for (int64_t j = 0; j < columns; ++j) to[j] += static_cast<double>(x[m * columns + j]);
    }
  });
  std::fill_n(sums, columns, 0.0);
  for (int64_t b = 0; b < blocks; ++b) {
    for (int64_t j = 0; j < columns; ++j) sums[j] += partial[static_cast<size_t>(b * columns + j)];
  }
}

namespace {

/// One slice [k0, k1) of the inner dimension; rows of `a` contiguous. Bias only with the first slice.
template <class T>
void gemm_slice(int64_t m, int64_t n, int64_t k0, int64_t k1, const T* a, int64_t lda, const MatrixView<T>& b,
                const T* bias, T* c, bool parallel) {
  PackedWeights<T> packed(1, k1 - k0, n, bias);
  packed.fill(
      [&](int64_t, int64_t r, int64_t j) { return b.data[(k0 + r) * b.row_stride + j * b.column_stride]; },
      parallel);
  const Tiles<T>& tile = tiles<T>();
  constexpr int64_t kRowsPerUnit = 64;
  const int64_t units = (m + kRowsPerUnit - 1) / kRowsPerUnit;
  const auto run_unit = [&](int64_t index) {
    const int64_t unit = index / packed.panels, p = index % packed.panels;
    DotTile<T> t;
    t.a_stride = lda;
    t.run = k1 - k0;
    t.c_stride = n;
    t.b = packed.panel(p);
    t.bias = packed.has_bias ? packed.bias.data() + p * packed.width : nullptr;
    t.columns = std::min(packed.width, n - p * packed.width);
    const int64_t end = std::min(m, (unit + 1) * kRowsPerUnit);
    for (int64_t row = unit * kRowsPerUnit; row < end; row += tile.rows) {
      t.rows = std::min(tile.rows, end - row);
      t.a = a + row * lda + k0;
      t.c = c + row * n + p * packed.width;
      tile.dot(t, packed.vectors);
    }
  };
  if (parallel) {
    parallel_for(units * packed.panels, run_unit);
  } else {
    for (int64_t i = 0; i < units * packed.panels; ++i) run_unit(i);
  }
}

}  // namespace

template <class T>
void gemm(int64_t m, int64_t n, int64_t k, const MatrixView<T>& a, const MatrixView<T>& b, const T* bias,
          T* c, bool parallel) {
  if (m == 0 || n == 0) return;
  // The tile walks rows of a, so a transposed one is copied first.
  const T* rows = a.data;
  int64_t lda = a.row_stride;
  const Scratch<T> copy(a.column_stride == 1 ? 0 : m * k);
  if (a.column_stride != 1) {
    const auto transpose = [&](int64_t begin, int64_t end) {
      for (int64_t i = begin; i < end; ++i) {
        for (int64_t j = 0; j < k; ++j) {
          copy.data()[i * k + j] = a.data[i * a.row_stride + j * a.column_stride];
        }
      }
    };
    if (parallel) {
      parallel_blocks(m, 16, transpose);
    } else {
      transpose(0, m);
    }
    rows = copy.data();
    lda = k;
  }
  constexpr int64_t kSlice = 8192;  // longer sums in T would lose digits: slices are joined in double
  if (k <= kSlice) {
    gemm_slice(m, n, 0, k, rows, lda, b, bias, c, parallel);
    return;
  }
  const int64_t slices = (k + kSlice - 1) / kSlice;
  std::vector<double> total(static_cast<size_t>(m * n), 0.0);
  constexpr int64_t kGroup = 16;  // slices in flight, to bound the memory of the partial products
  const Scratch<T> partial(std::min(kGroup, slices) * m * n);
  for (int64_t begin = 0; begin < slices; begin += kGroup) {
    const int64_t end = std::min(begin + kGroup, slices);
    const auto run_slice = [&](int64_t i) {
      gemm_slice(m, n, (begin + i) * kSlice, std::min(k, (begin + i + 1) * kSlice), rows, lda, b,
                 static_cast<const T*>(nullptr), partial.data() + i * m * n, false);
    };
    if (parallel) {
      parallel_for(end - begin, run_slice);
    } else {
      for (int64_t i = 0; i < end - begin; ++i) run_slice(i);
    }
    for (int64_t i = 0; i < end - begin; ++i) {
      for (int64_t j = 0; j < m * n; ++j) {
        total[static_cast<size_t>(j)] += static_cast<double>(partial.data()[i * m * n + j]);
      }
    }
  }
  for (int64_t i = 0; i < m; ++i) {
    for (int64_t j = 0; j < n; ++j) {
      const double offset = bias != nullptr ? static_cast<double>(bias[j]) : 0.0;
      c[i * n + j] = static_cast<T>(total[static_cast<size_t>(i * n + j)] + offset);
    }
  }
}

template void conv_forward(const ConvShape&, const float*, const float*, const float*, float*);
template void conv_forward(const ConvShape&, const double*, const double*, const double*, double*);
template void conv_input_gradient(const ConvShape&, const float*, const float*, const float*, float*);
template void conv_input_gradient(const ConvShape&, const double*, const double*, const double*, double*);
template void conv_weight_gradient(const ConvShape&, const float*, const float*, float*);
template void conv_weight_gradient(const ConvShape&, const double*, const double*, double*);
template void column_sums(const float*, int64_t, int64_t, double*);
template void column_sums(const double*, int64_t, int64_t, double*);
template void gemm(int64_t, int64_t, int64_t, const MatrixView<float>&, const MatrixView<float>&,
                   const float*, float*, bool);
template void gemm(int64_t, int64_t, int64_t, const MatrixView<double>&, const MatrixView<double>&,
                   const double*, double*, bool);

}  // namespace opaline::kernels
