// Matrix product and sums of columns. All sizes in elements. The order of every sum depends on the shapes
// alone.
#pragma once

#include <cstdint>

namespace opaline::kernels {

/// sums[j] = sum over m < rows of x[m*columns + j], in double, in a fixed order.
template <class T>
void column_sums(const T* x, int64_t rows, int64_t columns, double* sums);

/// c (m x n) = a^T b for contiguous a (k x m) and b (k x n): the gradient of a matrix of weights.
template <class T>
void gemm_tn(int64_t m, int64_t n, int64_t k, const T* a, const T* b, T* c);

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
