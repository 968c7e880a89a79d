#include "core/ops/resize.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "core/autograd.h"
#include "core/kernels/pixel.h"
#include "core/parallel.h"

namespace opaline {
namespace {

void check(std::string_view operation, const Tensor& x, const UpsampleOptions& options) {
  if (x.dim() != 4 || x.numel() == 0) {
    fail(operation, "input has shape {}, expected N x H x W x C", to_string(x.shape()));
  }
  if (options.height < 1 || options.width < 1) {
    fail(operation, "output size {}x{}; expected at least 1x1", options.height, options.width);
  }
}

/// An output position lies between source positions `low` and `high`, `weight` of the way.
struct Tap {
  int64_t low, high;
  double weight;
};

std::vector<Tap> bilinear_taps(int64_t in, int64_t out, bool align_corners) {
  std::vector<Tap> taps(static_cast<size_t>(out));
  for (int64_t i = 0; i < out; ++i) {
    double source = 0.0;
    if (align_corners) {
      source = out > 1 ? static_cast<double>(i) * (static_cast<double>(in - 1) / static_cast<double>(out - 1))
                       : 0.0;
    } else {
      source = std::max(
          0.0, (static_cast<double>(i) + 0.5) * (static_cast<double>(in) / static_cast<double>(out)) - 0.5);
    }
    const int64_t low = std::min(static_cast<int64_t>(source), in - 1);
    taps[static_cast<size_t>(i)] = {low, std::min(low + 1, in - 1), source - static_cast<double>(low)};
  }
  return taps;
}

std::vector<Tap> nearest_taps(int64_t in, int64_t out) {
  std::vector<Tap> taps(static_cast<size_t>(out));
  for (int64_t i = 0; i < out; ++i) {
    const int64_t low = i * in / out;
    taps[static_cast<size_t>(i)] = {low, low, 0.0};
  }
  return taps;
}

/// For each source position the output positions that read it, with their weights, in order: the transpose of
/// the taps, so that the gradient too has one owner for each pixel.
struct Reader {
  int64_t position;
  double weight;
};

std::vector<std::vector<Reader>> readers(const std::vector<Tap>& taps, int64_t in) {
  std::vector<std::vector<Reader>> result(static_cast<size_t>(in));
  for (size_t i = 0; i < taps.size(); ++i) {
    const Tap& tap = taps[i];
    const auto position = static_cast<int64_t>(i);
    if (tap.weight != 1.0) result[static_cast<size_t>(tap.low)].push_back({position, 1.0 - tap.weight});
    if (tap.weight != 0.0) result[static_cast<size_t>(tap.high)].push_back({position, tap.weight});
  }
  return result;
}

Tensor resample(std::string_view operation, const Tensor& x, const std::vector<Tap>& rows,
                const std::vector<Tap>& columns) {
  const int64_t n = x.size(0), h = x.size(1), w = x.size(2), c = x.size(3);
  const auto out_h = static_cast<int64_t>(rows.size()), out_w = static_cast<int64_t>(columns.size());
  Tensor y({n, out_h, out_w, c}, x.dtype());
  dispatch_floating(operation, x.dtype(), [&]<class T>() {
    parallel_blocks(n * out_h, 4, [&](int64_t begin, int64_t end) {
      for (int64_t i = begin; i < end; ++i) {
        const Tap& row = rows[static_cast<size_t>(i % out_h)];
        const T* const image = x.data<T>() + i / out_h * h * w * c;
        for (int64_t j = 0; j < out_w; ++j) {
          const Tap& column = columns[static_cast<size_t>(j)];
          // Taps of weight zero are left out: zero times infinity would be NaN.
          const T* pixels[4];
          T weights[4];
          int64_t count = 0;
          for (const auto& [at, v] :
               {std::pair(row.low, 1.0 - row.weight), std::pair(row.high, row.weight)}) {
            for (const auto& [from, u] :
                 {std::pair(column.low, 1.0 - column.weight), std::pair(column.high, column.weight)}) {
              if (v == 0.0 || u == 0.0) continue;
              pixels[count] = image + (at * w + from) * c;
              weights[count++] = static_cast<T>(v * u);
            }
          }
          kernels::pixel_kernels<T>().combine(pixels, weights, count, c, y.data<T>() + (i * out_w + j) * c);
        }
      }
    });
  });
  if (!should_record({&x})) return y;
  return record(
      operation, y, {x},
      [operation, n, h, w, c, out_h, out_w, by_row = readers(rows, h), by_column = readers(columns, w)](
          const Tensor& dy, std::span<const char>) {
        Tensor dx({n, h, w, c}, dy.dtype());
        dispatch_floating(operation, dy.dtype(), [&]<class T>() {
          parallel_blocks(n * h, 4, [&](int64_t begin, int64_t end) {
            std::vector<const T*> pixels;
            std::vector<T> weights;
            for (int64_t i = begin; i < end; ++i) {
              const T* const image = dy.data<T>() + i / h * out_h * out_w * c;
              for (int64_t j = 0; j < w; ++j) {
                pixels.clear();
                weights.clear();
                for (const Reader& row : by_row[static_cast<size_t>(i % h)]) {
                  for (const Reader& column : by_column[static_cast<size_t>(j)]) {
                    pixels.push_back(image + (row.position * out_w + column.position) * c);
                    weights.push_back(static_cast<T>(row.weight * column.weight));
                  }
                }
                T* const to = dx.data<T>() + (i * w + j) * c;
                if (pixels.empty()) {
                  std::fill_n(to, c, T{});
                } else {
                  kernels::pixel_kernels<T>().combine(pixels.data(), weights.data(),
                                                      static_cast<int64_t>(pixels.size()), c, to);
                }
              }
            }
          });
        });
        return std::vector<Tensor>{dx};
      },
      [operation, kept = x.saved(), rows, columns] {
        return resample(operation, kept.restored(), rows, columns);
      });
}

}  // namespace

Tensor upsample_bilinear(const Tensor& x, const UpsampleOptions& options) {
  check("upsample_bilinear", x, options);
  return resample("upsample_bilinear", x, bilinear_taps(x.size(1), options.height, options.align_corners),
                  bilinear_taps(x.size(2), options.width, options.align_corners));
}

Tensor upsample_nearest(const Tensor& x, const UpsampleOptions& options) {
  check("upsample_nearest", x, options);
  if (options.align_corners) fail("upsample_nearest", "align_corners has no meaning for nearest neighbours");
  return resample("upsample_nearest", x, nearest_taps(x.size(1), options.height),
                  nearest_taps(x.size(2), options.width));
}

}  // namespace opaline
