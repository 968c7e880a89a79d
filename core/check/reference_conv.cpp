#include <cmath>

#include "core/check/reference.h"

namespace opaline::check::reference {
namespace {

/// Index into [0, size) of padded position i, mirrored at the ends without repeating them; -1 outside where
/// zeros are padded.
int64_t source(int64_t i, int64_t size, bool reflect) {
  if (i >= 0 && i < size) return i;
  if (!reflect) return -1;
  return i < 0 ? -i : 2 * (size - 1) - i;
}

}  // namespace

Array conv2d(const Array& x, const Array& weight, const std::optional<Array>& bias,
             const ConvParameters& parameters) {
  const auto [stride, padding, reflect] = parameters;
  const int64_t h = x.size(1), w = x.size(2), in = x.size(3);
  const int64_t out = weight.size(0), kernel_h = weight.size(2), kernel_w = weight.size(3);
  const int64_t out_h = (h + 2 * padding - kernel_h) / stride + 1;
  const int64_t out_w = (w + 2 * padding - kernel_w) / stride + 1;
  Array y({x.size(0), out_h, out_w, out});
  for (int64_t n = 0; n < x.size(0); ++n) {
    for (int64_t i = 0; i < out_h; ++i) {
      for (int64_t j = 0; j < out_w; ++j) {
        for (int64_t o = 0; o < out; ++o) {
          double total = bias ? (*bias)[o] : 0.0;
          for (int64_t p = 0; p < kernel_h; ++p) {
            for (int64_t q = 0; q < kernel_w; ++q) {
              const int64_t row = source(i * stride + p - padding, h, reflect);
              const int64_t column = source(j * stride + q - padding, w, reflect);
              if (row < 0 || column < 0) continue;
              for (int64_t k = 0; k < in; ++k) total += x(n, row, column, k) * weight(o, k, p, q);
            }
          }
          y(n, i, j, o) = total;
        }
      }
    }
  }
  return y;
}

Array conv_transpose2d(const Array& x, const Array& weight, const std::optional<Array>& bias,
                       const ConvParameters& parameters) {
  const int64_t stride = parameters.stride, padding = parameters.padding;
  const int64_t h = x.size(1), w = x.size(2), in = x.size(3);
  const int64_t out = weight.size(1), kernel_h = weight.size(2), kernel_w = weight.size(3);
  Array y(
      {x.size(0), (h - 1) * stride - 2 * padding + kernel_h, (w - 1) * stride - 2 * padding + kernel_w, out});
  if (bias) {
    for (int64_t i = 0; i < y.count(); ++i) y[i] = (*bias)[i % out];
  }
  // Every input pixel stamps the kernel, scaled by its value, onto the output.
  for (int64_t n = 0; n < x.size(0); ++n) {
    for (int64_t i = 0; i < h; ++i) {
      for (int64_t j = 0; j < w; ++j) {
        for (int64_t p = 0; p < kernel_h; ++p) {
          for (int64_t q = 0; q < kernel_w; ++q) {
            const int64_t row = i * stride + p - padding, column = j * stride + q - padding;
            if (row < 0 || row >= y.size(1) || column < 0 || column >= y.size(2)) continue;
            for (int64_t o = 0; o < out; ++o) {
              for (int64_t k = 0; k < in; ++k) y(n, row, column, o) += x(n, i, j, k) * weight(k, o, p, q);
            }
          }
        }
      }
    }
  }
  return y;
}

Array reflection_pad2d(const Array& x, int64_t padding) {
  const int64_t h = x.size(1), w = x.size(2);
  Array y({x.size(0), h + 2 * padding, w + 2 * padding, x.size(3)});
  for (int64_t n = 0; n < x.size(0); ++n) {
    for (int64_t i = 0; i < y.size(1); ++i) {
      for (int64_t j = 0; j < y.size(2); ++j) {
        for (int64_t k = 0; k < x.size(3); ++k) {
          y(n, i, j, k) = x(n, source(i - padding, h, true), source(j - padding, w, true), k);
        }
      }
    }
  }
  return y;
}

Array linear(const Array& x, const Array& weight, const std::optional<Array>& bias) {
  const int64_t out = weight.size(0), in = weight.size(1);
  Shape shape = x.shape;
  shape.back() = out;
  Array y(shape);
  for (int64_t row = 0; row < y.count() / out; ++row) {
    for (int64_t o = 0; o < out; ++o) {
      double total = bias ? (*bias)[o] : 0.0;
      for (int64_t k = 0; k < in; ++k) total += x[row * in + k] * weight(o, k);
      y[row * out + o] = total;
    }
  }
  return y;
}

Array matmul(const Array& a, const Array& b, bool transpose_a, bool transpose_b) {
  const size_t rank = a.shape.size();
  const int64_t m = a.shape[rank - (transpose_a ? 1 : 2)];
  const int64_t k = a.shape[rank - (transpose_a ? 2 : 1)];
  const int64_t n = b.shape[rank - (transpose_b ? 2 : 1)];
  Shape shape = a.shape;
  shape[rank - 2] = m;
  shape[rank - 1] = n;
  Array y(shape);
  for (int64_t batch = 0; batch < y.count() / (m * n); ++batch) {
    for (int64_t i = 0; i < m; ++i) {
      for (int64_t j = 0; j < n; ++j) {
        double total = 0.0;
        for (int64_t l = 0; l < k; ++l) {
          total += a[batch * m * k + (transpose_a ? l * m + i : i * k + l)] *
                   b[batch * k * n + (transpose_b ? j * k + l : l * n + j)];
        }
        y[batch * m * n + i * n + j] = total;
      }
    }
  }
  return y;
}

Array attention(const Array& query, const Array& key, const Array& value, int64_t heads) {
  const int64_t depth = query.last() / heads, keys = key.size(1);
  Array y(query.shape);
  for (int64_t n = 0; n < query.size(0); ++n) {
    for (int64_t i = 0; i < query.size(1); ++i) {
      for (int64_t h = 0; h < heads; ++h) {
        Array scores(Shape{keys});
        for (int64_t j = 0; j < keys; ++j) {
          for (int64_t c = h * depth; c < (h + 1) * depth; ++c) scores[j] += query(n, i, c) * key(n, j, c);
          scores[j] /= std::sqrt(static_cast<double>(depth));
        }
        const Array weights = softmax(scores);
        for (int64_t j = 0; j < keys; ++j) {
          for (int64_t c = h * depth; c < (h + 1) * depth; ++c) y(n, i, c) += weights[j] * value(n, j, c);
        }
      }
    }
  }
  return y;
}

}  // namespace opaline::check::reference
