#include "core/ops/pool.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include "core/autograd.h"
#include "core/parallel.h"

namespace opaline {

Tensor max_pool2d(const Tensor& x, int64_t kernel) {
  if (x.dim() != 4) fail("max_pool2d", "input has shape {}, expected N x H x W x C", to_string(x.shape()));
  const int64_t n = x.size(0), h = x.size(1), w = x.size(2), c = x.size(3);
  if (kernel < 1 || kernel > h || kernel > w || kernel > 15) {
    fail("max_pool2d", "kernel {} does not fit input {} (and at most 15)", kernel, to_string(x.shape()));
  }
  const int64_t out_h = h / kernel, out_w = w / kernel;
  Tensor y({n, out_h, out_w, c}, x.dtype());
  const bool recording = should_record({&x});
  // Position of the maximum in its window: a byte, where an index would be as large as the values.
  auto chosen = std::make_shared<std::vector<uint8_t>>(recording ? static_cast<size_t>(y.numel()) : 0);
  dispatch_floating("max_pool2d", x.dtype(), [&]<class T>() {
    parallel_blocks(n * out_h, 4, [&](int64_t begin, int64_t end) {
      std::vector<uint8_t> position(static_cast<size_t>(c));
      for (int64_t row = begin; row < end; ++row) {
        for (int64_t column = 0; column < out_w; ++column) {
          const T* const corner =
              x.data<T>() + ((row / out_h * h + row % out_h * kernel) * w + column * kernel) * c;
          T* const best = y.data<T>() + (row * out_w + column) * c;
          std::copy_n(corner, c, best);
          std::fill(position.begin(), position.end(), uint8_t{0});
          for (int64_t k = 1; k < kernel * kernel; ++k) {
            const T* const from = corner + (k / kernel * w + k % kernel) * c;
            for (int64_t j = 0; j < c; ++j) {
              // NaN wins: it is not below anything, and nothing is above it.
              const bool larger = from[j] > best[j] || std::isnan(from[j]);
              best[j] = larger ? from[j] : best[j];
              position[static_cast<size_t>(j)] =
                  larger ? static_cast<uint8_t>(k) : position[static_cast<size_t>(j)];
            }
          }
          if (recording)
            std::copy(position.begin(), position.end(), chosen->begin() + (row * out_w + column) * c);
        }
      }
    });
  });
  if (!recording) return y;
  return record("max_pool2d", y, {x},
                [chosen, n, h, w, c, kernel, out_h, out_w](const Tensor& dy, std::span<const char>) {
                  Tensor dx = Tensor::zeros({n, h, w, c}, dy.dtype());
                  dispatch_floating("max_pool2d", dy.dtype(), [&]<class T>() {
                    parallel_blocks(n * out_h, 4, [&](int64_t begin, int64_t end) {
                      for (int64_t row = begin; row < end; ++row) {
                        for (int64_t column = 0; column < out_w; ++column) {
                          T* const corner =
                              dx.data<T>() +
                              ((row / out_h * h + row % out_h * kernel) * w + column * kernel) * c;
                          const int64_t at = (row * out_w + column) * c;
                          for (int64_t j = 0; j < c; ++j) {
                            const int64_t k = (*chosen)[static_cast<size_t>(at + j)];
                            corner[(k / kernel * w + k % kernel) * c + j] = dy.data<T>()[at + j];
                          }
                        }
                      }
                    });
                  });
                  return std::vector<Tensor>{dx};
                });
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
