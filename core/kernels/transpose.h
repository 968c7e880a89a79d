// Transposition in registers: what weights pass through on their way into panels.
#pragma once

#include <cstdint>

namespace opaline::kernels {

/// to[j * to_stride + i] = from[i * from_stride + j] for i < rows, j < columns, and 0 for rows <= i < width.
/// `width` is a multiple of Tiles::lanes, at least `rows` and at most to_stride.
template <class T>
void transpose(const T* from, int64_t from_stride, int64_t rows, int64_t columns, T* to, int64_t to_stride,
               int64_t width);

}  // namespace opaline::kernels
