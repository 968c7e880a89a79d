// Convolution over channels-last arrays. Each pass takes the algorithm that is fastest for its shape among
// those whose rounding error the choice of numerics admits. All sizes in elements. The order of every sum
// depends on the shapes and on which pixels exist alone. With `sites` arrays hold only these pixels.
#pragma once

#include <cstdint>

#include "core/kernels/conv_plan.h"
#include "core/kernels/image.h"

namespace opaline::kernels {

/// y = conv(x, weight) + bias; bias null for none. The parts of x make up its channels.
template <class T>
void conv_forward(const ConvShape& s, ConvPlan& plan, Parts<const T> x, const T* weight, const T* bias, T* y,
                  const ConvSites& sites = {});

/// dx = gradient of conv's input from dy; `bias` (of dx's channels, or null) is added: conv_transpose2d's.
/// Parts without data are not wanted, and not computed.
template <class T>
void conv_input_gradient(const ConvShape& s, ConvPlan& plan, const T* dy, const T* weight, const T* bias,
                         Parts<T> dx, const ConvSites& sites = {});

/// dweight (out x in x kernel_h x kernel_w) = gradient of conv's weight, overwritten.
template <class T>
void conv_weight_gradient(const ConvShape& s, ConvPlan& plan, Parts<const T> x, const T* dy, T* dweight,
                          const ConvSites& sites = {});

/// dx (n x h x w x channels) = the gradient of an image from that of its mirrored extension by `padding`
/// pixels. With `sites` dx holds these alone, and padded.sites are their mirrored ones.
template <class T>
void fold_reflection(const Image<T>& padded, int64_t padding, T* dx, const ActiveSites* sites = nullptr);

}  // namespace opaline::kernels
