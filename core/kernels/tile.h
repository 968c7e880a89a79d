// The two register tiles that every convolution and matrix product is made of, for float and double, compiled
// for several instruction sets and chosen at run time. Neither needs its inputs copied into panels of pixels:
// channels-last images already have what a tile reads next to each other.
#pragma once

#include <cstdint>

namespace opaline::kernels {

/// Products summed in registers before they go to memory. A longer chain of roundings would cost digits; and
/// a piece of a panel as long as this stays in the innermost cache while all rows pass by.
constexpr int64_t kChain = 128;

/// c[l][i][j] = bias[j] + sum_{q < runs} sum_{k < run} a[l*a_line + i*a_stride + q*a_run_stride + k] *
/// b[q*run + k][j] for l < lines, i < rows, j < columns. For a convolution l is an output row, i a pixel of
/// it, q the kernel's row, and k runs over (kernel column, channel), which are contiguous in a channels-last
/// image. Sums are made in chains of kChain products: one that is cut between chains has the same bits.
template <class T>
struct DotTile {
  const T* a = nullptr;
  int64_t a_line = 0;
  int64_t a_stride = 0;
  int64_t a_run_stride = 0;
  int64_t runs = 1;
  int64_t run = 0;
  const T* b = nullptr;     ///< panel of [runs * run][width], zero beyond `columns`; 64-byte aligned
  const T* bias = nullptr;  ///< `width` values or null for zeros
  T* c = nullptr;
  int64_t c_line = 0;
  int64_t c_stride = 0;
  int64_t lines = 1;
  int64_t rows = 0;
  int64_t columns = 0;      ///< at most the panel's width
  bool accumulate = false;  ///< onto what is there, without the bias
};

/// c[i][j] = sum_{x < pixels} a[x*a_stride + i] * b[x*b_stride + j] for i < rows, j < columns, added to what
/// is there where `accumulate`: the gradient of a weight, summed over pixels.
template <class T>
struct OuterTile {
  const T* a = nullptr;
  int64_t a_line = 0;
  int64_t a_stride = 0;
  const T* b = nullptr;  ///< rows of whole vectors: readable up to the width
  int64_t b_line = 0;
  int64_t b_stride = 0;
  int64_t lines = 1;
  int64_t pixels = 0;
  T* c = nullptr;
  int64_t c_stride = 0;
  int64_t rows = 0;     ///< at most Tiles::rows
  int64_t columns = 0;  ///< at most the width
  bool accumulate = false;
};

/// The tiles of the best instruction set that this machine has.
template <class T>
struct Tiles {
  int64_t rows = 0;                                                ///< most rows of an outer tile
  int64_t lanes = 0;                                               ///< elements of a vector
  void (*dot)(const DotTile<T>& tile, int64_t vectors) = nullptr;  ///< panel width = vectors * lanes; 1 or 2
  void (*outer)(const OuterTile<T>& tile) = nullptr;               ///< one vector where `columns` fit it
  const char* instruction_set = "";

  int64_t width() const { return 2 * lanes; }
  /// Vectors of a panel for a matrix of this many columns.
  int64_t vectors_for(int64_t columns) const { return columns <= lanes ? 1 : 2; }
};

template <class T>
const Tiles<T>& tiles();

}  // namespace opaline::kernels
