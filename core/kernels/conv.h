// Convolution over channels-last arrays. Each pass takes the algorithm that is fastest for its shape among
// those whose rounding error the choice of numerics admits. All sizes in elements. The order of every sum
// depends on the shapes alone.
#pragma once

#include <cstdint>

#include "core/kernels/image.h"
#include "core/numerics.h"

namespace opaline::kernels {

/// Shape of conv2d: x is n x h x w x in, y is n x out_h x out_w x out, the weight out x in x kernel_h x
/// kernel_w. Around x lie `padding` pixels of zeros, or of its mirror image with `reflect`.
struct ConvShape {
  int64_t n = 0, h = 0, w = 0, in = 0;
  int64_t out = 0, kernel_h = 0, kernel_w = 0;
  int64_t stride = 1, padding = 0;
  bool reflect = false;

  int64_t out_h() const { return (h + 2 * padding - kernel_h) / stride + 1; }
  int64_t out_w() const { return (w + 2 * padding - kernel_w) / stride + 1; }
  template <class T>
  Image<T> input(const T* x) const {
    return {x, n, h, w, in, reflect ? padding : 0};
  }
  template <class T>
  Image<T> output(const T* y) const {
    return {y, n, out_h(), out_w(), out, 0};
  }
};

enum class ConvPass { kForward, kInputGradient, kWeightGradient };

/// Whether Winograd's algorithm can do this shape.
inline bool winograd_fits(const ConvShape& s) {
  return s.kernel_h == 3 && s.kernel_w == 3 && s.stride == 1 && s.padding <= 2;
}

/// Outputs a side of Winograd's tiles for a pass over this shape, or 0 for the direct algorithm.
int winograd_outputs(const ConvShape& s, ConvPass pass, Numerics numerics);

/// y = conv(x, weight) + bias; bias null for none.
template <class T>
void conv_forward(const ConvShape& s, Numerics numerics, const T* x, const T* weight, const T* bias, T* y);

/// dx = gradient of conv's input from dy; `bias` (of dx's channels, or null) is added: conv_transpose2d's.
template <class T>
void conv_input_gradient(const ConvShape& s, Numerics numerics, const T* dy, const T* weight, const T* bias,
                         T* dx);

/// dweight (out x in x kernel_h x kernel_w) = gradient of conv's weight, overwritten.
template <class T>
void conv_weight_gradient(const ConvShape& s, Numerics numerics, const T* x, const T* dy, T* dweight);

/// dx (n x h x w x channels) = the gradient of an image from that of its mirrored extension by `padding`
/// pixels.
template <class T>
void fold_reflection(const Image<T>& padded, int64_t padding, T* dx);

}  // namespace opaline::kernels
