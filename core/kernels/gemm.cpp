#include "core/kernels/gemm.h"

#include <algorithm>
#include <vector>

#include "core/kernels/norm.h"
#include "core/kernels/panels.h"
#include "core/parallel.h"

namespace opaline::kernels {

template <class T>
void column_sums(const T* x, int64_t rows, int64_t columns, double* sums) {
  constexpr int64_t kBlock = 1024;
  const NormKernels<T>& k = norm_kernels<T>();
  const int64_t blocks = (rows + kBlock - 1) / kBlock, width = k.padded(columns);
  std::vector<double> partial(static_cast<size_t>(blocks * width), 0.0);
  parallel_for(blocks, [&](int64_t b) {
    k.column_sums(x + b * kBlock * columns, std::min(kBlock, rows - b * kBlock), columns,
                  partial.data() + b * width);
  });
  std::fill_n(sums, columns, 0.0);
  for (int64_t b = 0; b < blocks; ++b) {
    for (int64_t j = 0; j < columns; ++j) sums[j] += partial[static_cast<size_t>(b * width + j)];
  }
}

template <class T>
void gemm_tn(int64_t m, int64_t n, int64_t k, const T* a, const T* b, T* c) {
  const Tiles<T>& tile = tiles<T>();
  constexpr int64_t kRows = 128, kBlockN = 256;  // of a chunk and of a unit
  constexpr int64_t kPerFlush = 32;              // chunks summed in T before double takes over
  // The more rows a unit has, the less it copies; but there should be units for several threads.
  constexpr int64_t kUnits = 8;
  const int64_t block_m = std::clamp<int64_t>(m * n / (kUnits * kBlockN) / 64 * 64, 64, 256);
  const int64_t width = tile.width();
  const int64_t down = (m + block_m - 1) / block_m, across = (n + kBlockN - 1) / kBlockN;
  if (k == 0) std::fill_n(c, m * n, T{});
  if (k == 0 || m * n == 0) return;
  parallel_for(down * across, [&](int64_t unit) {
    const int64_t i0 = unit % down * block_m, j0 = unit / down * kBlockN;
    const int64_t rows = std::min(block_m, m - i0), columns = std::min(kBlockN, n - j0);
    const int64_t padded = (columns + width - 1) / width * width;
    const bool flushes = k > kRows * kPerFlush, once = k <= kRows;
    const Scratch<T> left(kRows * block_m), right(kRows * padded), sums(once ? 0 : rows * padded);
    const Scratch<double> total(flushes ? rows * padded : 0);
    for (int64_t begin = 0, chunk = 0; begin < k; begin += kRows, ++chunk) {
      const int64_t count = std::min(kRows, k - begin);
      // Copied, because rows of many columns would share few sets of the caches.
      for (int64_t r = 0; r < count; ++r) {
        std::copy_n(a + (begin + r) * m + i0, rows, left.data() + r * block_m);
        const T* const from = b + (begin + r) * n + j0;
        for (int64_t j = 0; j < padded; j += width) {
          T* const to = right.data() + j * kRows + r * width;
          const int64_t valid = std::min(width, columns - j);
          std::copy_n(from + j, valid, to);
          std::fill(to + valid, to + width, T{});
        }
      }
      OuterTile<T> t;
      t.a_stride = block_m;
      t.b_stride = width;
      t.pixels = count;
      t.c_stride = once ? n : padded;
      t.accumulate = chunk % kPerFlush != 0;
      for (int64_t j = 0; j < padded; j += width) {
        t.b = right.data() + j * kRows;
        t.columns = once ? std::min(width, columns - j) : width;
        for (int64_t i = 0; i < rows; i += tile.rows) {
          t.a = left.data() + i;
          t.rows = std::min(tile.rows, rows - i);
          t.c = once ? c + (i0 + i) * n + j0 + j : sums.data() + i * padded + j;
          tile.outer(t);
        }
      }
      if (flushes && ((chunk + 1) % kPerFlush == 0 || begin + count == k)) {
        for (int64_t i = 0; i < rows * padded; ++i) {
          total.data()[i] = (chunk < kPerFlush ? 0.0 : total.data()[i]) + static_cast<double>(sums.data()[i]);
        }
      }
    }
    for (int64_t i = 0; !once && i < rows; ++i) {
      T* const to = c + (i0 + i) * n + j0;
      if (!flushes) {
        std::copy_n(sums.data() + i * padded, columns, to);
      } else {
        for (int64_t j = 0; j < columns; ++j) to[j] = static_cast<T>(total.data()[i * padded + j]);
      }
    }
  });
}

namespace {

/// The same for few rows, which a panel meets as soon as it is packed, while it is near the core.
template <class T>
void gemm_few_rows(int64_t m, int64_t n, int64_t k, const T* a, int64_t lda, const MatrixView<T>& b,
                   const T* bias, T* c) {
  const Tiles<T>& tile = tiles<T>();
  const int64_t vectors = tile.vectors_for(n), width = vectors * tile.lanes;
  parallel_for((n + width - 1) / width, [&](int64_t p) {
    const int64_t first = p * width, valid = std::min(width, n - first);
    const Scratch<T> panel(kChain * width), offset(width);
    if (bias != nullptr)
      std::fill(std::copy_n(bias + first, valid, offset.data()), offset.data() + width, T{});
    DotTile<T> t;
    t.a_stride = lda;
    t.b = panel.data();
    t.bias = bias == nullptr ? nullptr : offset.data();
    t.c = c + first;
    t.c_stride = n;
    t.rows = m;
    t.columns = valid;
    const int64_t chains = (k + kChain - 1) / kChain;
    for (int64_t chain = 0; chain < chains; ++chain) {
      const int64_t begin = chain * k / chains, end = (chain + 1) * k / chains;
      pack_rows(b.data + begin * b.row_stride + first * b.column_stride, b.row_stride, b.column_stride,
                end - begin, valid, width, chain + 1 < chains ? end - begin : 0, panel.data());
      t.a = a + begin;
      t.run = end - begin;
      t.accumulate = chain > 0;
      tile.dot(t, vectors);
    }
  });
}

/// One slice [k0, k1) of the inner dimension; rows of `a` contiguous. Bias only with the first slice.
template <class T>
void gemm_slice(int64_t m, int64_t n, int64_t k0, int64_t k1, const T* a, int64_t lda, const MatrixView<T>& b,
                const T* bias, T* c, bool parallel) {
  PackedWeights<T> packed(1, k1 - k0, n, bias);
  packed.fill(b.data + k0 * b.row_stride, b.row_stride, b.column_stride, parallel);
  const Tiles<T>& tile = tiles<T>();
  constexpr int64_t kRowsPerUnit = 64;
  const int64_t units = (m + kRowsPerUnit - 1) / kRowsPerUnit;
  const auto run_unit = [&](int64_t index) {
    const int64_t unit = index / packed.panels, p = index % packed.panels;
    DotTile<T> t;
    t.a_stride = lda;
    t.run = k1 - k0;
    t.c_stride = n;
    t.b = packed.panel(p);
    t.bias = packed.has_bias ? packed.bias.data() + p * packed.width : nullptr;
    t.columns = std::min(packed.width, n - p * packed.width);
    const int64_t row = unit * kRowsPerUnit;
    t.rows = std::min(kRowsPerUnit, m - row);
    t.a = a + row * lda + k0;
    t.c = c + row * n + p * packed.width;
    tile.dot(t, packed.vectors);
  };
  if (parallel) {
    parallel_for(units * packed.panels, run_unit);
  } else {
    for (int64_t i = 0; i < units * packed.panels; ++i) run_unit(i);
  }
}

}  // namespace

template <class T>
PackedMatrix<T>::PackedMatrix(int64_t k, int64_t n, const MatrixView<T>& b) : packed_(1, k, n, nullptr) {
  packed_.fill(b.data, b.row_stride, b.column_stride, false);
}

template <class T>
void PackedMatrix<T>::multiply(int64_t m, const T* a, int64_t a_stride, T* c, int64_t c_stride) const {
  const Tiles<T>& tile = tiles<T>();
  DotTile<T> t;
  t.a_stride = a_stride;
  t.run = packed_.run;
  t.c_stride = c_stride;
  for (int64_t p = 0; p < packed_.panels; ++p) {
    t.b = packed_.panel(p);
    t.columns = std::min(packed_.width, packed_.columns - p * packed_.width);
    t.rows = m;
    t.a = a;
    t.c = c + p * packed_.width;
    tile.dot(t, packed_.vectors);
  }
}

template class PackedMatrix<float>;
template class PackedMatrix<double>;

template <class T>
void gemm(int64_t m, int64_t n, int64_t k, const MatrixView<T>& a, const MatrixView<T>& b, const T* bias,
          T* c, bool parallel) {
  if (m == 0 || n == 0) return;
  // The tile walks rows of a, so a transposed one is copied first.
  const T* rows = a.data;
  int64_t lda = a.row_stride;
  const Scratch<T> copy(a.column_stride == 1 ? 0 : m * k);
  if (a.column_stride != 1) {
    const auto transpose = [&](int64_t begin, int64_t end) {
      for (int64_t i = begin; i < end; ++i) {
        for (int64_t j = 0; j < k; ++j) {
          copy.data()[i * k + j] = a.data[i * a.row_stride + j * a.column_stride];
        }
      }
    };
    if (parallel) {
      parallel_blocks(m, 16, transpose);
    } else {
      transpose(0, m);
    }
    rows = copy.data();
    lda = k;
  }
  constexpr int64_t kSlice = 8192;  // longer sums in T would lose digits: slices are joined in double
  constexpr int64_t kFewRows = 128, kLeastColumns = 256;
  if (parallel && k > 0 && k <= kSlice && m <= kFewRows && n >= kLeastColumns) {
    return gemm_few_rows(m, n, k, rows, lda, b, bias, c);
  }
  if (k <= kSlice) {
    gemm_slice(m, n, 0, k, rows, lda, b, bias, c, parallel);
    return;
  }
  const int64_t slices = (k + kSlice - 1) / kSlice;
  std::vector<double> total(static_cast<size_t>(m * n), 0.0);
  constexpr int64_t kGroup = 16;  // slices in flight, to bound the memory of the partial products
  const Scratch<T> partial(std::min(kGroup, slices) * m * n);
  for (int64_t begin = 0; begin < slices; begin += kGroup) {
    const int64_t end = std::min(begin + kGroup, slices);
    const auto run_slice = [&](int64_t i) {
      gemm_slice(m, n, (begin + i) * kSlice, std::min(k, (begin + i + 1) * kSlice), rows, lda, b,
                 static_cast<const T*>(nullptr), partial.data() + i * m * n, false);
    };
    if (parallel) {
      parallel_for(end - begin, run_slice);
    } else {
      for (int64_t i = 0; i < end - begin; ++i) run_slice(i);
    }
    for (int64_t i = 0; i < end - begin; ++i) {
      for (int64_t j = 0; j < m * n; ++j) {
        total[static_cast<size_t>(j)] += static_cast<double>(partial.data()[i * m * n + j]);
      }
    }
  }
  for (int64_t i = 0; i < m; ++i) {
    for (int64_t j = 0; j < n; ++j) {
      const double offset = bias != nullptr ? static_cast<double>(bias[j]) : 0.0;
      c[i * n + j] = static_cast<T>(total[static_cast<size_t>(i * n + j)] + offset);
    }
  }
}

template void column_sums(const float*, int64_t, int64_t, double*);
template void column_sums(const double*, int64_t, int64_t, double*);
template void gemm_tn(int64_t, int64_t, int64_t, const float*, const float*, float*);
template void gemm_tn(int64_t, int64_t, int64_t, const double*, const double*, double*);
template void gemm(int64_t, int64_t, int64_t, const MatrixView<float>&, const MatrixView<float>&,
                   const float*, float*, bool);
template void gemm(int64_t, int64_t, int64_t, const MatrixView<double>&, const MatrixView<double>&,
                   const double*, double*, bool);

}  // namespace opaline::kernels
