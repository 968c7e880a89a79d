#include "core/ops/pool.h"

#include <algorithm>
#include <vector>

#include "core/autograd.h"
#include "core/kernels/pixel.h"
#include "core/ops/sites.h"
#include "core/parallel.h"

namespace opaline {
namespace {

constexpr int64_t kMaxKernel = 15;
constexpr int64_t kMaxWindow = kMaxKernel * kMaxKernel;

/// The windows of a pooling, whole images or sites: for each output the first pixel of its windows' rows.
class Windows {
 public:
  Windows(const ImageSize& size, int64_t kernel, std::shared_ptr<const ActiveSites> sites)
      : size_(size),
        kernel_(kernel),
        out_h_(size.h / kernel),
        out_w_(size.w / kernel),
        sites_(std::move(sites)) {
    if (!sites_) return;
    if (kernel != 2 || out_h_ * 2 != size.h || out_w_ * 2 != size.w) {
      fail("max_pool2d", "of active sites halves images of even sides; kernel {} of {} x {}", kernel, size.h,
           size.w);
    }
    out_sites_ = sites_->halved();
  }

  const std::shared_ptr<const ActiveSites>& out_sites() const { return out_sites_; }
  Shape out_shape() const {
    return sites_ ? Shape{out_sites_->count(), size_.channels}
                  : Shape{size_.n, out_h_, out_w_, size_.channels};
  }
  /// Whether every pixel of the input is in a window.
  bool cover() const { return out_h_ * kernel_ == size_.h && out_w_ * kernel_ == size_.w; }

  /// Calls f(first element of an output, the first elements of its window's pixels that exist, their number).
  template <class F>
  void for_each(const F& f) const {
    parallel_blocks(size_.n * out_h_, 4, [&](int64_t begin, int64_t end) {
      int64_t pixels[kMaxWindow];
      for (int64_t i = begin; i < end; ++i) {
        for (int64_t column = 0; column < out_w_; ++column) {
          const int64_t image = i / out_h_, row = i % out_h_;
          const int64_t out = sites_ ? out_sites_->site(image, row, column) : i * out_w_ + column;
          if (out < 0) continue;
          int64_t count = 0;
          for (int64_t k = 0; k < kernel_ * kernel_; ++k) {
            const int64_t y = row * kernel_ + k / kernel_, x = column * kernel_ + k % kernel_;
            const int64_t pixel = sites_ ? sites_->site(image, y, x) : (image * size_.h + y) * size_.w + x;
            if (pixel >= 0) pixels[count++] = pixel * size_.channels;
          }
          f(out * size_.channels, pixels, count);
        }
      }
    });
  }

 private:
  ImageSize size_;
  int64_t kernel_, out_h_, out_w_;
  std::shared_ptr<const ActiveSites> sites_, out_sites_;
};

}  // namespace

Tensor max_pool2d(const Tensor& x, int64_t kernel) {
  const ImageSize size = image_size("max_pool2d", x);
  if (kernel < 1 || kernel > size.h || kernel > size.w || kernel > kMaxKernel) {
    fail("max_pool2d", "kernel {} does not fit input {} (and at most 15)", kernel, to_string(x.shape()));
  }
  const Windows windows(size, kernel, x.sites());
  const int64_t c = size.channels;
  Tensor y(windows.out_shape(), x.dtype());
  y.set_sites(windows.out_sites());
  dispatch_floating("max_pool2d", x.dtype(), [&]<class T>() {
    windows.for_each([&](int64_t to, const int64_t* from, int64_t count) {
      const T* pixels[kMaxWindow];
      for (int64_t k = 0; k < count; ++k) pixels[k] = x.data<T>() + from[k];
      kernels::pixel_kernels<T>().largest(pixels, count, c, y.data<T>() + to);
    });
  });
  if (!should_record({&x})) return y;
  return record(
      "max_pool2d", y, {x},
      [kept = x.saved(), windows, c](const Tensor& dy, std::span<const char>) {
        const Tensor values = kept.restored();
        Tensor dx =
            windows.cover() ? Tensor(values.shape(), dy.dtype()) : Tensor::zeros(values.shape(), dy.dtype());
        dispatch_floating("max_pool2d", dy.dtype(), [&]<class T>() {
          windows.for_each([&](int64_t at, const int64_t* from, int64_t count) {
            const T* pixels[kMaxWindow];
            T* targets[kMaxWindow];
            for (int64_t k = 0; k < count; ++k) {
              pixels[k] = values.data<T>() + from[k];
              targets[k] = dx.data<T>() + from[k];
            }
            kernels::pixel_kernels<T>().largest_gradient(pixels, dy.data<T>() + at, count, c, targets);
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
