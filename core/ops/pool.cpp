#include "core/ops/pool.h"

#include <algorithm>
#include <vector>

#include "core/autograd.h"
#include "core/kernels/pixel.h"
#include "core/parallel.h"

namespace opaline {
namespace {

constexpr int64_t kMaxKernel = 15;
constexpr int64_t kMaxWindow = kMaxKernel * kMaxKernel;

}  // namespace

Tensor max_pool2d(const Tensor& x, int64_t kernel) {
  if (x.dim() != 4) fail("max_pool2d", "input has shape {}, expected N x H x W x C", to_string(x.shape()));
  const int64_t n = x.size(0), h = x.size(1), w = x.size(2), c = x.size(3);
  if (kernel < 1 || kernel > h || kernel > w || kernel > kMaxKernel) {
    fail("max_pool2d", "kernel {} does not fit input {} (and at most 15)", kernel, to_string(x.shape()));
  }
  const int64_t out_h = h / kernel, out_w = w / kernel, window = kernel * kernel;
  Tensor y({n, out_h, out_w, c}, x.dtype());
  // Calls f(first element of an output, first element of its window).
  const auto for_windows = [n, h, w, c, kernel, out_h, out_w](const auto& f) {
    parallel_blocks(n * out_h, 4, [&](int64_t begin, int64_t end) {
      for (int64_t row = begin; row < end; ++row) {
        for (int64_t column = 0; column < out_w; ++column) {
          f((row * out_w + column) * c, ((row / out_h * h + row % out_h * kernel) * w + column * kernel) * c);
        }
      }
    });
  };
  const auto offset = [w, c, kernel](int64_t k) { return (k / kernel * w + k % kernel) * c; };
  dispatch_floating("max_pool2d", x.dtype(), [&]<class T>() {
    for_windows([&](int64_t to, int64_t from) {
      const T* pixels[kMaxWindow];
      for (int64_t k = 0; k < window; ++k) pixels[k] = x.data<T>() + from + offset(k);
      kernels::pixel_kernels<T>().largest(pixels, window, c, y.data<T>() + to);
    });
  });
  if (!should_record({&x})) return y;
  return record(
      "max_pool2d", y, {x},
      [kept = x.saved(), for_windows, offset, window, whole = out_h * kernel == h && out_w * kernel == w](
          const Tensor& dy, std::span<const char>) {
        const Tensor values = kept.restored();
        // Windows cover everything but what no multiple of the kernel reaches.
        Tensor dx = whole ? Tensor(values.shape(), dy.dtype()) : Tensor::zeros(values.shape(), dy.dtype());
        dispatch_floating("max_pool2d", dy.dtype(), [&]<class T>() {
          for_windows([&](int64_t at, int64_t from) {
            const T* pixels[kMaxWindow];
            T* targets[kMaxWindow];
            for (int64_t k = 0; k < window; ++k) {
              pixels[k] = values.data<T>() + from + offset(k);
              targets[k] = dx.data<T>() + from + offset(k);
            }
            kernels::pixel_kernels<T>().largest_gradient(pixels, dy.data<T>() + at, window, values.size(3),
                                                         targets);
          });
        });
        return std::vector<Tensor>{dx};
      },
      [kept = x.saved(), kernel] { return max_pool2d(kept.restored(), kernel); });
}

Tensor adaptive_avg_pool2d(const Tensor& x, int64_t out_height, int64_t out_width) {
  if (x.dim() != 4 || x.numel() == 0) {
    fail("adaptive_avg_pool2d", "input has shape {}, expected N x H x W x C", to_string(x.shape()));
  }
  if (out_height < 1 || out_width < 1) {
    fail("adaptive_avg_pool2d", "output size {}x{}; expected at least 1x1", out_height, out_width);
  }
  const int64_t n = x.size(0), h = x.size(1), w = x.size(2), c = x.size(3);
  const auto first = [](int64_t i, int64_t in, int64_t out) { return i * in / out; };
  const auto last = [](int64_t i, int64_t in, int64_t out) { return ((i + 1) * in + out - 1) / out; };
  Tensor y({n, out_height, out_width, c}, x.dtype());
  dispatch_floating("adaptive_avg_pool2d", x.dtype(), [&]<class T>() {
    parallel_for(n * out_height, [&](int64_t row) {
      const int64_t image = row / out_height, i = row % out_height;
      std::vector<double> sums(static_cast<size_t>(c));
      for (int64_t j = 0; j < out_width; ++j) {
        const int64_t y0 = first(i, h, out_height), y1 = last(i, h, out_height);
        const int64_t x0 = first(j, w, out_width), x1 = last(j, w, out_width);
        std::fill(sums.begin(), sums.end(), 0.0);
        for (int64_t p = y0; p < y1; ++p) {
          for (int64_t q = x0; q < x1; ++q) {
            const T* const from = x.data<T>() + ((image * h + p) * w + q) * c;
            for (int64_t k = 0; k < c; ++k) sums[static_cast<size_t>(k)] += static_cast<double>(from[k]);
          }
        }
        T* const to = y.data<T>() + (row * out_width + j) * c;
        const double scale = 1.0 / static_cast<double>((y1 - y0) * (x1 - x0));
        for (int64_t k = 0; k < c; ++k) to[k] = static_cast<T>(sums[static_cast<size_t>(k)] * scale);
      }
    });
  });
  if (!should_record({&x})) return y;
  return record("adaptive_avg_pool2d", y, {x},
                [n, h, w, c, out_height, out_width, first, last](const Tensor& dy, std::span<const char>) {
                  Tensor dx = Tensor::zeros({n, h, w, c}, dy.dtype());
                  dispatch_floating("adaptive_avg_pool2d", dy.dtype(), [&]<class T>() {
                    parallel_for(n, [&](int64_t image) {  // windows may overlap: an image has one owner
                      for (int64_t i = 0; i < out_height; ++i) {
                        for (int64_t j = 0; j < out_width; ++j) {
                          const int64_t y0 = first(i, h, out_height), y1 = last(i, h, out_height);
                          const int64_t x0 = first(j, w, out_width), x1 = last(j, w, out_width);
                          const T scale = static_cast<T>(1.0 / static_cast<double>((y1 - y0) * (x1 - x0)));
                          const T* const from = dy.data<T>() + ((image * out_height + i) * out_width + j) * c;
                          for (int64_t p = y0; p < y1; ++p) {
                            for (int64_t q = x0; q < x1; ++q) {
                              T* const to = dx.data<T>() + ((image * h + p) * w + q) * c;
                              for (int64_t k = 0; k < c; ++k) to[k] += from[k] * scale;
                            }
                          }
                        }
                      }
                    });
                  });
                  return std::vector<Tensor>{dx};
                });
}

}  // namespace opaline
