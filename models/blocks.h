// What the encoders share: convolution + BatchNorm + ReLU, and the way from feature maps to a vector.
#pragma once

#include <span>

#include "nn/conv.h"
#include "nn/sequential.h"

namespace opaline {

/// The first layers of an encoder: [reflection padding 3, conv 7x7 without bias, BatchNorm, ReLU], four
/// indices. The input may come as images that are joined along their channels.
class Stem {
 public:
  /// Appends them to a sequence that has no steps yet.
  Stem(Sequential& sequence, int64_t in, int64_t out, DType dtype);
  /// The whole sequence, whatever has been appended since.
  Tensor forward(std::span<const Tensor> parts) const;

 private:
  const Sequential* sequence_;
  const Conv2d* conv_;
};

/// Appends [conv 3x3 stride 2 padding 1 without bias, BatchNorm, ReLU]: three indices, half the size.
void add_halving_conv(Sequential& sequence, int64_t in, int64_t out, DType dtype);

struct VectorHeadConfig {
  int64_t in = 0;    ///< channels of the map
  int64_t grid = 0;  ///< positions a side that the Linear layer sees; other maps are averaged to it
  int64_t out = 0;
  DType dtype = DType::kFloat32;
};

/// Appends [flatten in (c, h, w) order, Linear with bias, BatchNorm]: three indices; the result is N x out.
void add_vector_head(Sequential& sequence, const VectorHeadConfig& config);

}  // namespace opaline
