// Direct convolution and matrix product over channels-last arrays: the loops around the register tiles of
// tile.h. All sizes in elements. The order of every sum depends on the shapes alone.
#pragma once

#include <cstdint>

namespace opaline::kernels {

/// Shape of conv2d: x is n x h x w x in, y is n x out_h x out_w x out, the weight out x in x kernel_h x
/// kernel_w.
struct ConvShape {
  int64_t n = 0, h = 0, w = 0, in = 0;
  int64_t out = 0, kernel_h = 0, kernel_w = 0;
  int64_t stride = 1, padding = 0;

  int64_t out_h() const { return (h + 2 * padding - kernel_h) / stride + 1; }
  int64_t out_w() const { return (w + 2 * padding - kernel_w) / stride + 1; }
};

/// y = conv(x, weight) + bias; bias null for none.
template <class T>
void conv_forward(const ConvShape& s, const T* x, const T* weight, const T* bias, T* y);

/// dx = gradient of conv's input from dy; `bias` (of dx's channels, or null) is added: conv_transpose2d's.
template <class T>
void conv_input_gradient(const ConvShape& s, const T* dy, const T* weight, const T* bias, T* dx);

/// dweight (out x in x kernel_h x kernel_w) = gradient of conv's weight, overwritten.
template <class T>
void conv_weight_gradient(const ConvShape& s, const T* x, const T* dy, T* dweight);

/// sums[j] = sum over m < rows of x[m*columns + j], in double, in a fixed order.
template <class T>
void column_sums(const T* x, int64_t rows, int64_t columns, double* sums);

/// A matrix in memory: element (i, j) at data[i * row_stride + j * column_stride].
template <class T>
struct MatrixView {
  const T* data = nullptr;
  int64_t row_stride = 0;
  int64_t column_stride = 1;
};

/// c (m x n, contiguous) = a (m x k) b (k x n) + bias (n, or null). Uses all threads where `parallel`.
template <class T>
void gemm(int64_t m, int64_t n, int64_t k, const MatrixView<T>& a, const MatrixView<T>& b, const T* bias,
          T* c, bool parallel = true);

}  // namespace opaline::kernels
