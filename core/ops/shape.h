// Operations that move elements without changing them. All results are contiguous.
#pragma once

#include <span>

#include "core/tensor.h"

namespace opaline {

/// Joins along dimension `axis` (negative counts from the end); other sizes must agree.
Tensor concat(std::span<const Tensor> parts, int64_t axis = -1);
Tensor concat(std::initializer_list<Tensor> parts, int64_t axis = -1);
/// Same elements under another shape; one dimension may be -1.
Tensor reshape(const Tensor& x, Shape shape);
/// Result dimension i is x's dimension order[i].
Tensor permute(const Tensor& x, std::vector<int64_t> order);
/// Elements [begin, end) of dimension `axis`.
Tensor slice(const Tensor& x, int64_t axis, int64_t begin, int64_t end);
/// Repeats dimensions of size one (and missing leading ones) up to `shape`.
Tensor expand(const Tensor& x, Shape shape);

/// N x C x H x W -> N x H x W x C.
Tensor to_nhwc(const Tensor& x);
/// N x H x W x C -> N x C x H x W.
Tensor to_nchw(const Tensor& x);

}  // namespace opaline
