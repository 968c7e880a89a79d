// Convolutions. Activations N x H x W x C; weights in PyTorch's layout.
#pragma once

#include <span>

#include "core/tensor.h"

namespace opaline {

enum class Padding { kZeros, kReflect };

struct Conv2dOptions {
  int64_t stride = 1;
  int64_t padding = 0;
  Padding padding_mode = Padding::kZeros;  ///< kReflect needs padding < height and width
};

/// y[n,oh,ow,o] = bias[o] + sum_{i,kh,kw} x[n, oh*stride+kh-padding, ow*stride+kw-padding, i] *
/// weight[o,i,kh,kw]. x: N x H x W x I, weight: O x I x KH x KW, bias: O or undefined. Result: N x OH x OW x
/// O with OH = (H + 2*padding - KH) / stride + 1 (floor). Of active sites (sites x I -> sites x O) the kernel
/// must keep the image's size, or halve it with stride 2.
Tensor conv2d(const Tensor& x, const Tensor& weight, const Tensor& bias = {},
              const Conv2dOptions& options = {});

/// The same of images that are joined along their channels, without making the joined image. parts: N x H x W
/// x I_1, N x H x W x I_2, ..; weight: O x (I_1 + I_2 + ..) x KH x KW.
Tensor conv2d(std::span<const Tensor> parts, const Tensor& weight, const Tensor& bias = {},
              const Conv2dOptions& options = {});

struct ConvTranspose2dOptions {
  int64_t stride = 1;
  int64_t padding = 0;
};

/// The gradient of conv2d with respect to its input, as PyTorch's ConvTranspose2d.
/// x: N x H x W x I, weight: I x O x KH x KW, bias: O or undefined.
/// Result: N x OH x OW x O with OH = (H - 1) * stride - 2*padding + KH.
Tensor conv_transpose2d(const Tensor& x, const Tensor& weight, const Tensor& bias = {},
                        const ConvTranspose2dOptions& options = {});

/// Mirrors without repeating the border: x: N x H x W x C -> N x (H+2p) x (W+2p) x C; needs p < H and p < W.
Tensor reflection_pad2d(const Tensor& x, int64_t padding);

}  // namespace opaline
