#include "core/ops/resize.h"

#include <algorithm>
#include <utility>
#include <vector>

#include "core/autograd.h"
#include "core/kernels/pixel.h"
#include "core/ops/sites.h"
#include "core/parallel.h"

namespace opaline {
namespace {

void check(std::string_view operation, const Tensor& x, const UpsampleOptions& options) {
  const ImageSize size = image_size(operation, x);
  if (x.numel() == 0 && !x.sites()) {
    fail(operation, "input has shape {}, expected N x H x W x C", to_string(x.shape()));
  }
  if (!x.sites() != !options.sites) {
    fail(operation, "of active sites needs those of the result, and only then takes them");
  }
  if (options.sites && (options.sites->n() != size.n || options.sites->h() != options.height ||
                        options.sites->w() != options.width)) {
    fail(operation, "sites of {} images of {} x {} for {} of {} x {}", options.sites->n(), options.sites->h(),
         options.sites->w(), size.n, options.height, options.width);
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

/// Numbers of pixels in memory; negative for one that is absent.
struct PixelIndex {
  int64_t h, w;
  const ActiveSites* sites;

  int64_t operator()(int64_t image, int64_t row, int64_t column) const {
    return sites != nullptr ? sites->site(image, row, column) : (image * h + row) * w + column;
  }
};

Tensor resample(std::string_view operation, const Tensor& x, const std::vector<Tap>& rows,
                const std::vector<Tap>& columns, const std::shared_ptr<const ActiveSites>& sites) {
  const auto [n, h, w, c] = image_size(operation, x);
  const auto out_h = static_cast<int64_t>(rows.size()), out_w = static_cast<int64_t>(columns.size());
  Tensor y(sites ? Shape{sites->count(), c} : Shape{n, out_h, out_w, c}, x.dtype());
  y.set_sites(sites);
  const PixelIndex from_index{h, w, x.sites().get()}, to_index{out_h, out_w, sites.get()};
  dispatch_floating(operation, x.dtype(), [&, channels = c]<class T>() {
    parallel_blocks(n * out_h, 4, [&](int64_t begin, int64_t end) {
      for (int64_t i = begin; i < end; ++i) {
        const Tap& row = rows[static_cast<size_t>(i % out_h)];
        for (int64_t j = 0; j < out_w; ++j) {
          const int64_t to = to_index(i / out_h, i % out_h, j);
          if (to < 0) continue;
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
              const int64_t pixel = from_index(i / out_h, at, from);
              if (pixel < 0) continue;
              pixels[count] = x.data<T>() + pixel * channels;
              weights[count++] = static_cast<T>(v * u);
            }
          }
          T* const target = y.data<T>() + to * channels;
          if (count == 0) {
            std::fill_n(target, channels, T{});
          } else {
            kernels::pixel_kernels<T>().combine(pixels, weights, count, channels, target);
          }
        }
      }
    });
  });
  if (!should_record({&x})) return y;
  return record(
      operation, y, {x},
      [operation, size = ImageSize{n, h, w, c}, out_h, out_w, x_sites = x.sites(), sites,
       by_row = readers(rows, h), by_column = readers(columns, w)](const Tensor& dy, std::span<const char>) {
        const int64_t channels = size.channels;
        Tensor dx(x_sites ? Shape{x_sites->count(), channels} : Shape{size.n, size.h, size.w, channels},
                  dy.dtype());
        const PixelIndex x_index{size.h, size.w, x_sites.get()}, y_index{out_h, out_w, sites.get()};
        dispatch_floating(operation, dy.dtype(), [&]<class T>() {
          parallel_blocks(size.n * size.h, 4, [&](int64_t begin, int64_t end) {
            std::vector<const T*> pixels;
            std::vector<T> weights;
            for (int64_t i = begin; i < end; ++i) {
              const int64_t image = i / size.h;
              for (int64_t j = 0; j < size.w; ++j) {
                const int64_t at = x_index(image, i % size.h, j);
                if (at < 0) continue;
                pixels.clear();
                weights.clear();
                for (const Reader& row : by_row[static_cast<size_t>(i % size.h)]) {
                  for (const Reader& column : by_column[static_cast<size_t>(j)]) {
                    const int64_t pixel = y_index(image, row.position, column.position);
                    if (pixel < 0) continue;
                    pixels.push_back(dy.data<T>() + pixel * channels);
                    weights.push_back(static_cast<T>(row.weight * column.weight));
                  }
                }
                T* const to = dx.data<T>() + at * channels;
                if (pixels.empty()) {
                  std::fill_n(to, channels, T{});
                } else {
                  kernels::pixel_kernels<T>().combine(pixels.data(), weights.data(),
                                                      static_cast<int64_t>(pixels.size()), channels, to);
                }
              }
            }
          });
        });
        return std::vector<Tensor>{dx};
      },
      [operation, kept = x.saved(), rows, columns, sites] {
        return resample(operation, kept.restored(), rows, columns, sites);
      });
}

}  // namespace

Tensor upsample_bilinear(const Tensor& x, const UpsampleOptions& options) {
  check("upsample_bilinear", x, options);
  const ImageSize size = image_size("upsample_bilinear", x);
  return resample("upsample_bilinear", x, bilinear_taps(size.h, options.height, options.align_corners),
                  bilinear_taps(size.w, options.width, options.align_corners), options.sites);
}

Tensor upsample_nearest(const Tensor& x, const UpsampleOptions& options) {
  check("upsample_nearest", x, options);
  if (options.align_corners) fail("upsample_nearest", "align_corners has no meaning for nearest neighbours");
  const ImageSize size = image_size("upsample_nearest", x);
  return resample("upsample_nearest", x, nearest_taps(size.h, options.height),
                  nearest_taps(size.w, options.width), options.sites);
}

}  // namespace opaline
