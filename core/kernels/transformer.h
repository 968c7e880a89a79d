// Rows of tokens: softmax, GELU and layer norm, vectorised, compiled for several instruction sets and chosen
// at run time. float32 exponentials are within one unit in the last place, sums are in double, one vector of
// them.
#pragma once

#include <cstdint>

namespace opaline::kernels {

/// Sums of a row that a layer norm's gradient needs.
struct RowSums {
  double sum = 0.0, product = 0.0;
};

template <class T>
struct TransformerKernels {
  /// y = exp(scale * x - max) / sum, in place if y = x. NaN and rows without a finite maximum give NaN.
  void (*softmax)(const T* x, int64_t n, T scale, T* y) = nullptr;
  /// dx = scale * y * (dy - sum y dy), in place if dx = dy.
  void (*softmax_gradient)(const T* y, const T* dy, int64_t n, T scale, T* dx) = nullptr;
  /// y = x Phi(x), Phi(x) = erfc(-x / sqrt(2)) / 2: without the cancellation of 1 + erf for negative x.
  void (*gelu)(const T* x, int64_t n, T* y) = nullptr;
  void (*gelu_gradient)(const T* x, const T* dy, int64_t n, T* dx) = nullptr;
  /// Sum of x - center and of (x - center)^2.
  RowSums (*moments)(const T* x, int64_t n, double center) = nullptr;
  /// y = (x - mean) * inverse * weight + bias.
  void (*normalize)(const T* x, int64_t n, double mean, double inverse, const T* weight, const T* bias,
                    T* y) = nullptr;
  /// Sum of g = dy * weight and of g * (x - mean).
  RowSums (*normalize_sums)(const T* x, const T* dy, int64_t n, double mean, const T* weight) = nullptr;
  /// dx = inverse * (dy * weight - a - b * (x - mean)).
  void (*normalize_gradient)(const T* x, const T* dy, int64_t n, double mean, double inverse, const T* weight,
                             double a, double b, T* dx) = nullptr;
  /// weight_sums[j] += dy * (x - mean) * inverse, bias_sums[j] += dy.
  void (*normalize_parameter_sums)(const T* x, const T* dy, int64_t n, double mean, double inverse,
                                   double* weight_sums, double* bias_sums) = nullptr;
};

template <class T>
const TransformerKernels<T>& transformer_kernels();

}  // namespace opaline::kernels
