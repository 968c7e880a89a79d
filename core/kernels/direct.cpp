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

/// Panels of weights [first, last).
struct Panels {
  int64_t first, last;
};

/// Calls f(unit, panels) for units of pixels; where these are few, several times each, for some of the
/// panels.
template <class F>
void for_units(int64_t units, int64_t panels, const F& f) {
  constexpr int64_t kUnits = 16;
  const int64_t parts = std::clamp<int64_t>(kUnits / std::max<int64_t>(units, 1), 1, panels);
  parallel_for(units * parts, [&](int64_t i) {
    const int64_t part = i % parts;
    f(i / parts, Panels{part * panels / parts, (part + 1) * panels / parts});
  });
}

/// A convolution's inputs, for output rows from `first` on: those whose pixels lie in the image are read in
/// place, the others from copies with their border.
template <class T>
class Correlation {
 public:
  Correlation(const Image<T>& x, int64_t top, int64_t left, int64_t stride, const PackedWeights<T>& weights,
              int64_t out_w, const OutputView<T>& y)
      : x_(x),
        top_(top),
        left_(left),
        stride_(stride),
        weights_(weights),
        out_w_(out_w),
        y_(y),
        kernel_w_(weights.run / std::max<int64_t>(x.channels, 1)) {
    const auto columns_from = [&](int64_t space) { return space < 0 ? 0 : (space + stride - 1) / stride; };
    begin_ = std::min(columns_from(-left), out_w);
    end_ = std::clamp(columns_from(x.w - left - kernel_w_ + 1), begin_, out_w);
  }

  /// Output rows [first, last) of an image, for some panels of weights.
  void run(int64_t image, int64_t first, int64_t last, const Panels& panels) const {
    const int64_t row = top_ + first * stride_, count = last - first;
    const int64_t rows = (count - 1) * stride_ + weights_.kernel_h;
    T* const y = y_.data + image * y_.image_stride + first * y_.row_stride;
    if (begin_ < end_ && x_.sites == nullptr && x_.contains(row, 0, rows, x_.w)) {
      multiply({.a = x_.pixel(image, row, left_ + begin_ * stride_),
                .a_line = stride_ * x_.w * x_.channels,
                .a_stride = stride_ * x_.channels,
                .a_run_stride = x_.w * x_.channels,
                .c = y + begin_ * y_.pixel_stride,
                .c_line = y_.row_stride,
                .c_stride = y_.pixel_stride,
                .lines = count,
                .rows = end_ - begin_},
               panels);
      run_border(image, row, count, 0, begin_, y, panels);
      run_border(image, row, count, end_, out_w_, y, panels);
      return;
    }
    run_copy(image, first, 0, count, out_w_, y, y_.row_stride, panels);
  }

  /// `count` rows of `columns` outputs from (first, column) on, to `y` with `y_line` from a row to the next.
  void run_copy(int64_t image, int64_t first, int64_t column, int64_t count, int64_t columns, T* y,
                int64_t y_line, const Panels& panels) const {
    const int64_t row = top_ + first * stride_, rows = (count - 1) * stride_ + weights_.kernel_h;
    const int64_t width = (columns - 1) * stride_ + kernel_w_, line = width * x_.channels;
    const Scratch<T> copy(rows * line);
    for (int64_t i = 0; i < rows; ++i) {
      x_.copy_row(image, row + i, left_ + column * stride_, width, copy.data() + i * line);
    }
    multiply({.a = copy.data(),
              .a_line = stride_ * line,
              .a_stride = stride_ * x_.channels,
              .a_run_stride = line,
              .c = y,
              .c_line = y_line,
              .c_stride = y_.pixel_stride,
              .lines = count,
              .rows = columns},
             panels);
  }

 private:
  /// The output columns [begin, end) at a side, each with a copy of what its kernel meets.
  void run_border(int64_t image, int64_t row, int64_t count, int64_t begin, int64_t end, T* y,
                  const Panels& panels) const {
    if (begin == end) return;
    const int64_t patch = weights_.kernel_h * weights_.run;
    const Scratch<T> copy((end - begin) * count * patch);
    for (int64_t i = 0; i < (end - begin) * count * weights_.kernel_h; ++i) {
      const int64_t column = begin + i / weights_.kernel_h / count;
      const int64_t line = i / weights_.kernel_h % count * stride_ + i % weights_.kernel_h;
      x_.copy_row(image, row + line, left_ + column * stride_, kernel_w_, copy.data() + i * weights_.run);
    }
    multiply({.a = copy.data(),
              .a_line = count * patch,
              .a_stride = patch,
              .a_run_stride = weights_.run,
              .c = y + begin * y_.pixel_stride,
              .c_line = y_.pixel_stride,
              .c_stride = y_.row_stride,
              .lines = end - begin,
              .rows = count},
             panels);
  }

  /// Panels of weights, for a tile that lacks nothing else.
  void multiply(DotTile<T> t, const Panels& panels) const {
    t.runs = weights_.kernel_h;
    t.run = weights_.run;
    T* const c = t.c;
    for (int64_t p = panels.first; p < panels.last; ++p) {
      t.b = weights_.panel(p);
      t.bias = weights_.has_bias ? weights_.bias.data() + p * weights_.width : nullptr;
      t.columns = std::min(weights_.width, weights_.columns - p * weights_.width);
      t.c = c + p * weights_.width;
      tiles<T>().dot(t, weights_.vectors);
    }
  }

  const Image<T>& x_;
  int64_t top_, left_, stride_;
  const PackedWeights<T>& weights_;
  int64_t out_w_;
  const OutputView<T>& y_;
  int64_t kernel_w_;
  int64_t begin_ = 0, end_ = 0;  // columns whose kernels stay within the image's
};

/// The pixels `first`, `first` + `step`, .. of a row or column.
struct Lattice {
  int64_t first = 0, step = 1;

  /// How many of them lie before `end`.
  int64_t before(int64_t end) const { return end <= first ? 0 : (end - first + step - 1) / step; }
};

/// The same as below where only some outputs exist: those of `sites` that lie on the lattices, of which (i,
/// j) is output (i, j) of the correlation. y has `channels` channels.
template <class T>
void correlate_sites(const Image<T>& x, int64_t top, int64_t left, int64_t stride,
                     const PackedWeights<T>& weights, const ActiveSites& sites, const Lattice& rows,
                     const Lattice& columns, T* y, int64_t channels) {
  constexpr int64_t kPixelsPerUnit = 256;
  struct Unit {
    int64_t image, row, column, rows, columns;  // outputs
    T* y;
    int64_t line;
  };
  std::vector<Unit> units;
  for (const ActiveSites::Rectangle& r : sites.rectangles()) {
    const int64_t top_row = rows.before(r.row), end_row = rows.before(r.row + r.rows);
    const int64_t first = columns.before(r.column), count = columns.before(r.column + r.columns) - first;
    if (count == 0) continue;
    const int64_t each = std::max<int64_t>(1, kPixelsPerUnit / count);
    for (int64_t row = top_row; row < end_row; row += each) {
      const int64_t from_row = rows.first + row * rows.step - r.row;
      const int64_t site = r.site + from_row * r.line + columns.first + first * columns.step - r.column;
      units.push_back({r.image, row, first, std::min(each, end_row - row), count, y + site * channels,
                       rows.step * r.line * channels});
    }
  }
  const OutputView<T> view{y, 0, 0, columns.step * channels};
  const Correlation<T> correlation(x, top, left, stride, weights, 0, view);
  for_units(static_cast<int64_t>(units.size()), weights.panels, [&](int64_t i, const Panels& panels) {
    const Unit& unit = units[static_cast<size_t>(i)];
    correlation.run_copy(unit.image, unit.row, unit.column, unit.rows, unit.columns, unit.y, unit.line,
                         panels);
  });
}

/// y (x.n x out_h x out_w) = correlation of x with the weights; the first kernel's first pixel is (top,
/// left).
template <class T>
void correlate(const Image<T>& x, int64_t top, int64_t left, int64_t stride, const PackedWeights<T>& weights,
               int64_t out_h, int64_t out_w, const OutputView<T>& y) {
  // A unit holds enough pixels to make a panel of weights worth fetching, in several rows, because the rows
  // of the kernel overlap.
  constexpr int64_t kPixelsPerUnit = 256, kRowsPerUnit = 4;
  const int64_t rows = std::min(std::max(kPixelsPerUnit / std::max<int64_t>(out_w, 1), kRowsPerUnit),
                                std::max<int64_t>(out_h, 1));
  const int64_t units = (out_h + rows - 1) / rows;
  const Correlation<T> correlation(x, top, left, stride, weights, out_w, y);
  for_units(x.n * units, weights.panels, [&](int64_t unit, const Panels& panels) {
    const int64_t first = unit % units * rows;
    correlation.run(unit / units, first, std::min(first + rows, out_h), panels);
  });
}

/// The bias, or zeros, at the sites on the lattices.
template <class T>
void fill_sites(const ActiveSites& sites, const Lattice& rows, const Lattice& columns, const T* bias, T* y,
                int64_t channels) {
  for (const ActiveSites::Rectangle& r : sites.rectangles()) {
    for (int64_t i = rows.before(r.row); i < rows.before(r.row + r.rows); ++i) {
      const int64_t line = r.site + (rows.first + i * rows.step - r.row) * r.line;
      for (int64_t j = columns.before(r.column); j < columns.before(r.column + r.columns); ++j) {
        T* const to = y + (line + columns.first + j * columns.step - r.column) * channels;
        for (int64_t k = 0; k < channels; ++k) to[k] = bias != nullptr ? bias[k] : T{};
      }
    }
  }
}

}  // namespace

template <class T>
void direct_forward(const ConvShape& s, const T* x, const T* weight, const T* bias, T* y,
                    const ConvSites& sites) {
  std::vector<PackedWeights<T>> weights;
  const PackedWeights<T>& packed = weights.emplace_back(s.kernel_h, s.kernel_w * s.in, s.out, bias);
  const int64_t taps = s.kernel_h * s.kernel_w;
  fill_filters(weights, weight, s.in, taps, s.in * taps, taps, [&](int64_t tap) {
    return TapPlace{0, tap * s.in};
  });
  const Image<T> image = s.input(x, sites.x);
  if (sites.y != nullptr) {
    return correlate_sites(image, -s.padding, -s.padding, s.stride, packed, *sites.y, {}, {}, y, s.out);
  }
  correlate(image, -s.padding, -s.padding, s.stride, packed, s.out_h(), s.out_w(),
            OutputView<T>{y, s.out_h() * s.out_w() * s.out, s.out_w() * s.out, s.out});
}

// Row ih of dx meets row oh of dy through kernel row kh = ih + padding - stride * oh. With q = ih + padding,
// rows of one class c = q mod stride meet the kernel rows c, c + stride, .. and nothing else, so each of the
// stride^2 classes of pixels is a convolution of dy, without the zeros that dilation would multiply.
template <class T>
void direct_input_gradient(const ConvShape& s, const T* dy, const T* weight, const T* bias, T* dx,
                           const ConvSites& sites) {
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
  struct Class {
    Axis rows, columns;
    int64_t cy, cx;
  };
  std::vector<Class> classes;
  std::vector<PackedWeights<T>> weights;
  for (int64_t cy = 0; cy < s.stride; ++cy) {
    for (int64_t cx = 0; cx < s.stride; ++cx) {
      const Class c{axis(cy, h, s.kernel_h), axis(cx, w, s.kernel_w), cy, cx};
      if (c.rows.count == 0 || c.columns.count == 0) continue;
      classes.push_back(c);
      weights.emplace_back(c.rows.taps, c.columns.taps * s.out, s.in, bias);
    }
  }
  if (classes.empty()) return;
  const int64_t taps = s.kernel_h * s.kernel_w;
  fill_filters(weights, weight, s.out, s.in * taps, taps, taps, [&](int64_t tap) {
    const int64_t kh = tap / s.kernel_w, kw = tap % s.kernel_w;
    for (size_t i = 0; i < classes.size(); ++i) {
      const Class& c = classes[i];
      if (kh % s.stride != c.cy || kw % s.stride != c.cx) continue;
      return TapPlace{
          i,
          ((c.rows.taps - 1 - kh / s.stride) * c.columns.taps + c.columns.taps - 1 - kw / s.stride) * s.out};
    }
    return TapPlace{};
  });
  const Image<T> image = s.output(dy, sites.y);
  for (size_t i = 0; i < classes.size(); ++i) {
    const auto& [rows, columns, cy, cx] = classes[i];
    const bool reached = rows.taps > 0 && columns.taps > 0;
    if (sites.x != nullptr) {
      const Lattice down{rows.first, s.stride}, across{columns.first, s.stride};
      if (reached) {
        correlate_sites(image, rows.top, columns.top, 1, weights[i], *sites.x, down, across, dx, s.in);
      } else {
        fill_sites(*sites.x, down, across, bias, dx, s.in);
      }
      continue;
    }
    const OutputView<T> out{dx + (rows.first * w + columns.first) * s.in, h * w * s.in, s.stride * w * s.in,
                            s.stride * s.in};
    if (reached) {
      correlate(image, rows.top, columns.top, 1, weights[i], rows.count, columns.count, out);
      continue;
    }
    // No tap reaches these pixels: the bias alone.
    parallel_for(s.n * rows.count, [&, row_count = rows.count, column_count = columns.count](int64_t line) {
      T* to = out.data + line / row_count * out.image_stride + line % row_count * out.row_stride;
      for (int64_t x = 0; x < column_count; ++x, to += out.pixel_stride) {
        for (int64_t j = 0; j < s.in; ++j) to[j] = bias != nullptr ? bias[j] : T{};
      }
    });
  }
}

template void direct_forward(const ConvShape&, const float*, const float*, const float*, float*,
                             const ConvSites&);
template void direct_forward(const ConvShape&, const double*, const double*, const double*, double*,
                             const ConvSites&);
template void direct_input_gradient(const ConvShape&, const float*, const float*, const float*, float*,
                                    const ConvSites&);
template void direct_input_gradient(const ConvShape&, const double*, const double*, const double*, double*,
                                    const ConvSites&);

}  // namespace opaline::kernels
