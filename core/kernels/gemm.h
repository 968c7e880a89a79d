// Matrix product and sums of columns. All sizes in elements. The order of every sum depends on the shapes
// alone.
#pragma once

#include <cstdint>

#include "core/kernels/panels.h"

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

/// A k x n matrix packed once for several products, each on the calling thread.
template <class T>
class PackedMatrix {
 public:
  PackedMatrix(int64_t k, int64_t n, const MatrixView<T>& b);
  /// c (m x n, rows c_stride apart) = a (m x k, rows a_stride apart) times the matrix.
  void multiply(int64_t m, const T* a, int64_t a_stride, T* c, int64_t c_stride) const;

 private:
  PackedWeights<T> packed_;
};

/// c (m x n, contiguous) = a (m x k) b (k x n) + bias (n, or null). Uses all threads where `parallel`.
template <class T>
void gemm(int64_t m, int64_t n, int64_t k, const MatrixView<T>& a, const MatrixView<T>& b, const T* bias,
          T* c, bool parallel = true);

}  // namespace opaline::kernels
