#include <algorithm>
#include <cmath>

#include "core/check/reference.h"

namespace opaline::check::reference {

Array max_pool2d(const Array& x, int64_t kernel) {
  Array y({x.size(0), x.size(1) / kernel, x.size(2) / kernel, x.size(3)});
  for (int64_t n = 0; n < y.size(0); ++n) {
    for (int64_t i = 0; i < y.size(1); ++i) {
      for (int64_t j = 0; j < y.size(2); ++j) {
        for (int64_t k = 0; k < y.size(3); ++k) {
          double best = x(n, i * kernel, j * kernel, k);
          for (int64_t p = 0; p < kernel; ++p) {
            for (int64_t q = 0; q < kernel; ++q) {
              const double v = x(n, i * kernel + p, j * kernel + q, k);
              if (std::isnan(v) || v > best) best = v;
            }
          }
          y(n, i, j, k) = best;
        }
      }
    }
  }
  return y;
}

Array adaptive_avg_pool2d(const Array& x, int64_t height, int64_t width) {
  Array y({x.size(0), height, width, x.size(3)});
  const auto first = [](int64_t i, int64_t in, int64_t out) {
    return static_cast<int64_t>(std::floor(static_cast<double>(i * in) / static_cast<double>(out)));
  };
  const auto last = [](int64_t i, int64_t in, int64_t out) {
    return static_cast<int64_t>(std::ceil(static_cast<double>((i + 1) * in) / static_cast<double>(out)));
  };
  for (int64_t n = 0; n < y.size(0); ++n) {
    for (int64_t i = 0; i < height; ++i) {
      for (int64_t j = 0; j < width; ++j) {
        for (int64_t k = 0; k < y.size(3); ++k) {
          double total = 0.0, count = 0.0;
          for (int64_t p = first(i, x.size(1), height); p < last(i, x.size(1), height); ++p) {
            for (int64_t q = first(j, x.size(2), width); q < last(j, x.size(2), width); ++q) {
              total += x(n, p, q, k);
              count += 1.0;
            }
          }
          y(n, i, j, k) = total / count;
        }
      }
    }
  }
  return y;
}

namespace {

/// Where output position i lies in the source, as PyTorch defines it.
double source_position(int64_t i, int64_t in, int64_t out, bool align_corners) {
  const auto at = static_cast<double>(i);
  if (align_corners) return out > 1 ? at * static_cast<double>(in - 1) / static_cast<double>(out - 1) : 0.0;
  return std::max(0.0, (at + 0.5) * static_cast<double>(in) / static_cast<double>(out) - 0.5);
}

}  // namespace

Array upsample_bilinear(const Array& x, int64_t height, int64_t width, bool align_corners) {
  Array y({x.size(0), height, width, x.size(3)});
  for (int64_t i = 0; i < height; ++i) {
    const double v = source_position(i, x.size(1), height, align_corners);
    for (int64_t j = 0; j < width; ++j) {
      const double u = source_position(j, x.size(2), width, align_corners);
      // The weight of a source pixel is a tent around it; beyond the last pixel its value goes on.
      for (int64_t p = 0; p < x.size(1); ++p) {
        const double a = std::max(
            0.0, 1.0 - std::abs(std::min(v, static_cast<double>(x.size(1) - 1)) - static_cast<double>(p)));
        if (a == 0.0) continue;
        for (int64_t q = 0; q < x.size(2); ++q) {
          const double b = std::max(
              0.0, 1.0 - std::abs(std::min(u, static_cast<double>(x.size(2) - 1)) - static_cast<double>(q)));
          if (b == 0.0) continue;
          for (int64_t n = 0; n < x.size(0); ++n) {
            for (int64_t k = 0; k < x.size(3); ++k) y(n, i, j, k) += a * b * x(n, p, q, k);
          }
        }
      }
    }
  }
  return y;
}

Array upsample_nearest(const Array& x, int64_t height, int64_t width) {
  Array y({x.size(0), height, width, x.size(3)});
  for (int64_t n = 0; n < y.size(0); ++n) {
    for (int64_t i = 0; i < height; ++i) {
      for (int64_t j = 0; j < width; ++j) {
        for (int64_t k = 0; k < y.size(3); ++k) {
          y(n, i, j, k) = x(n, i * x.size(1) / height, j * x.size(2) / width, k);
        }
      }
    }
  }
  return y;
}

}  // namespace opaline::check::reference
