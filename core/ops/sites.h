// Between whole images and their active sites (core/active_sites.h), and what operations on images share to
// take either.
#pragma once

#include "core/tensor.h"

namespace opaline {

/// The active sites of whole images: N x H x W x C -> sites x C. An image that has sites already must have
/// the same ones.
Tensor select_sites(const Tensor& x, const std::shared_ptr<const ActiveSites>& sites);

/// The whole images, with `fill` where pixels are absent: sites x C -> N x H x W x C. Whole images stay as
/// they are.
Tensor to_dense(const Tensor& x, double fill = 0.0);

/// A vector an image at all of the image's sites: N x K -> sites x K.
Tensor expand_to_sites(const Tensor& x, const std::shared_ptr<const ActiveSites>& sites);

/// The tiles that a mask touches (core/active_sites.h). mask: N x H x W x 1, nonzero on the object; H and W
/// multiples of 16.
std::shared_ptr<const ActiveSites> support_of(const Tensor& mask, int64_t dilation = 0);

/// The sites that tensors of one shape have in common; null where none has any. Throws Error, naming the
/// operation, where they differ.
std::shared_ptr<const ActiveSites> common_sites(std::string_view operation, std::span<const Tensor> tensors);

/// What an image is, whole or sites of one.
struct ImageSize {
  int64_t n, h, w, channels;
};
/// Throws Error, naming the operation, where x is no image.
ImageSize image_size(std::string_view operation, const Tensor& x);

/// The sites as kernels take them: null where all pixels exist.
inline const ActiveSites* partial(const std::shared_ptr<const ActiveSites>& sites) {
  return sites && !sites->full() ? sites.get() : nullptr;
}

}  // namespace opaline
