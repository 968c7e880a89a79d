// Resampling of N x H x W x C to a given size, with PyTorch's coordinate rules.
#pragma once

#include "core/tensor.h"

namespace opaline {

struct UpsampleOptions {
  int64_t height = 0;
  int64_t width = 0;
  bool align_corners = false;  ///< true: source = i (in-1)/(out-1); false: (i+0.5) in/out - 0.5, clamped at 0
  /// Of the result, where the input has active sites: its absent pixels are zeros, and the weights of the
  /// others stay as they are.
  std::shared_ptr<const ActiveSites> sites = nullptr;
};

/// Bilinear interpolation.
Tensor upsample_bilinear(const Tensor& x, const UpsampleOptions& options);

/// Nearest neighbour: source index floor(i * in / out) (align_corners has no meaning here and must be false).
Tensor upsample_nearest(const Tensor& x, const UpsampleOptions& options);

}  // namespace opaline
