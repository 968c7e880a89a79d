// Losses. All give a scalar; targets and masks never get a gradient.
#pragma once

#include "core/tensor.h"

namespace opaline {

/// For each image sum over mask of |x - target| / (mask pixels * channels), then the mean over the batch.
/// An image with an empty mask gives 0. x, target: N x H x W x C; mask: N x H x W x 1 of zeros and ones. Or
/// the same active sites of all three.
Tensor masked_l1_loss(const Tensor& x, const Tensor& target, const Tensor& mask);

/// As masked_l1_loss with the squared difference.
Tensor masked_mse_loss(const Tensor& x, const Tensor& target, const Tensor& mask);

/// Mean of |x - target| over all elements; equal shapes.
Tensor l1_loss(const Tensor& x, const Tensor& target);

/// Mean of (x - target)^2 over all elements; equal shapes.
Tensor mse_loss(const Tensor& x, const Tensor& target);

/// Per image the mean over mask of 1 - cos(x, target) over the channels, then the mean over the batch; an
/// empty mask gives 0. The cosine's denominator is max(|x| |target|, 1e-8), as PyTorch documents it
/// (for targets of unit length it is what PyTorch computes; some versions clamp both lengths apart).
Tensor cosine_loss(const Tensor& x, const Tensor& target, const Tensor& mask);

}  // namespace opaline
