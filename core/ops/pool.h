// Pooling over N x H x W x C; the maximum also over active sites.
#pragma once

#include "core/tensor.h"

namespace opaline {

/// Maximum over non-overlapping `kernel` x `kernel` windows (stride = kernel, floor). The first maximum in
/// row order takes the gradient, NaN wins, as in PyTorch. Of active sites, halved: absent pixels are minus
/// infinity.
Tensor max_pool2d(const Tensor& x, int64_t kernel = 2);

/// Mean over the windows [floor(i*H/OH), ceil((i+1)*H/OH)), as PyTorch's AdaptiveAvgPool2d.
Tensor adaptive_avg_pool2d(const Tensor& x, int64_t out_height, int64_t out_width);

}  // namespace opaline
