// Direct convolution: every product of the definition, as matrix products over shifted rows of pixels. Any
// kernel and stride. Arguments as in conv.h; padded images of a reflecting convolution as in winograd.h.
#pragma once

#include "core/kernels/conv_plan.h"

namespace opaline::kernels {

template <class T>
void direct_forward(const ConvShape& s, const T* x, const T* weight, const T* bias, T* y,
                    const ConvSites& sites = {});

template <class T>
void direct_input_gradient(const ConvShape& s, const T* dy, const T* weight, const T* bias, T* dx,
                           const ConvSites& sites = {});

template <class T>
void direct_weight_gradient(const ConvShape& s, const T* x, const T* dy, T* dweight,
                            const ConvSites& sites = {});

}  // namespace opaline::kernels
