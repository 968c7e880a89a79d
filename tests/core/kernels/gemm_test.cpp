#include "core/kernels/gemm.h"

#include <catch2/catch.hpp>
#include <cmath>
#include <limits>
#include <string>
#include <vector>

#include "core/parallel.h"
#include "core/random.h"

namespace opaline::kernels {
namespace {

template <class T>
std::vector<T> numbers(int64_t count, uint32_t sample) {
  std::vector<T> result(static_cast<size_t>(count));
  Random random(7, Purpose::kTest, 0, sample);
  for (T& value : result) value = static_cast<T>(static_cast<float>(random.normal()));
  return result;
}

/// A matrix whose rows, or columns, are contiguous.
template <class T>
MatrixView<T> view(const std::vector<T>& values, int64_t rows, int64_t columns, bool turned) {
  return turned ? MatrixView<T>{values.data(), 1, rows} : MatrixView<T>{values.data(), columns, 1};
}

template <class T>
T at(const MatrixView<T>& m, int64_t i, int64_t j) {
  return m.data[i * m.row_stride + j * m.column_stride];
}

/// The largest difference between c and the product of a and b, plus the bias, in roundings of T times the
/// root of the length of the sums.
template <class T>
double error(int64_t m, int64_t n, int64_t k, const MatrixView<T>& a, const MatrixView<T>& b, const T* bias,
             const std::vector<T>& c) {
  double worst = 0.0;
  for (int64_t i = 0; i < m; ++i) {
    for (int64_t j = 0; j < n; ++j) {
      long double sum = bias == nullptr ? 0.0L : static_cast<long double>(bias[j]);
      for (int64_t l = 0; l < k; ++l)
        sum += static_cast<long double>(at(a, i, l)) * static_cast<long double>(at(b, l, j));
      const auto difference =
          static_cast<double>(std::abs(static_cast<long double>(c[static_cast<size_t>(i * n + j)]) - sum));
      if (!(difference <= worst)) worst = difference;
    }
  }
  return worst / std::sqrt(static_cast<double>(k) + 1.0) /
         static_cast<double>(std::numeric_limits<T>::epsilon());
}

template <class T>
std::vector<T> unwritten(int64_t count) {
  return std::vector<T>(static_cast<size_t>(count), std::numeric_limits<T>::quiet_NaN());
}

/// Sums of normal numbers are off by some roundings times the root of their length.
constexpr double kBound = 40.0;

struct Size {
  int64_t m, n, k;
};

template <class T>
void check_products() {
  // Few rows and many, panels that hang over, sums of one chain, of several, of uneven ones, and in slices.
  for (const Size& s : std::vector<Size>{{1, 1, 1},
                                         {5, 300, 290},
                                         {128, 256, 128},
                                         {129, 256, 128},
                                         {33, 257, 513},
                                         {128, 31, 300},
                                         {3, 260, 0},
                                         {2, 256, 8193},
                                         {70, 40, 20}}) {
    const auto a = numbers<T>(s.m * s.k, 1), b = numbers<T>(s.k * s.n, 2), bias = numbers<T>(s.n, 3);
    for (const int layout : {0, 1, 2, 3}) {
      const MatrixView<T> left = view(a, s.m, s.k, layout % 2 == 1),
                          right = view(b, s.k, s.n, layout / 2 == 1);
      for (const T* const offset : {static_cast<const T*>(nullptr), bias.data()}) {
        INFO(s.m << " x " << s.k << " times " << s.k << " x " << s.n << ", layout " << layout
                 << (offset == nullptr ? "" : ", bias"));
        auto c = unwritten<T>(s.m * s.n);
        gemm(s.m, s.n, s.k, left, right, offset, c.data());
        CHECK(error(s.m, s.n, s.k, left, right, offset, c) < kBound);
        // Neither threads nor whether there are any may change a bit.
        auto same = unwritten<T>(s.m * s.n);
        {
          const ThreadsGuard one(1);
          gemm(s.m, s.n, s.k, left, right, offset, same.data());
        }
        CHECK(same == c);
        gemm(s.m, s.n, s.k, left, right, offset, same.data(), false);
        CHECK(same == c);
      }
    }
  }
}

TEST_CASE("products of matrices are those of their definition, whatever the layout") {
  check_products<float>();
  check_products<double>();
}

template <class T>
void check_gradients() {
  for (const Size& s : std::vector<Size>{{1, 1, 1},
                                         {70, 300, 1},
                                         {64, 256, 128},
                                         {65, 257, 100},
                                         {3, 5, 128},
                                         {90, 270, 129},
                                         {17, 33, 300},
                                         {40, 20, 4100},
                                         {5, 7, 0}}) {
    const auto a = numbers<T>(s.k * s.m, 1), b = numbers<T>(s.k * s.n, 2);
    INFO(s.m << " x " << s.k << " times " << s.k << " x " << s.n);
    auto c = unwritten<T>(s.m * s.n);
    gemm_tn(s.m, s.n, s.k, a.data(), b.data(), c.data());
    const MatrixView<T> left{a.data(), 1, s.m}, right{b.data(), s.n, 1};
    CHECK(error(s.m, s.n, s.k, left, right, static_cast<const T*>(nullptr), c) < kBound);
    auto same = unwritten<T>(s.m * s.n);
    const ThreadsGuard one(1);
    gemm_tn(s.m, s.n, s.k, a.data(), b.data(), same.data());
    CHECK(same == c);
  }
}

TEST_CASE("gradients of matrices are sums over rows") {
  check_gradients<float>();
  check_gradients<double>();
}

}  // namespace
}  // namespace opaline::kernels
