// Winograd's convolution for square kernels of stride 1: the same results as the direct one with fewer
// multiplications and a larger rounding error (winograd_points.h). Kernels of 3 x 3 fit a tile; those of up
// to 8 x 8 are cut into four of 4 x 4. Tiles are taken in blocks that stay in the caches; nothing is
// transformed as a whole. The order of every sum depends on the shape alone.
#pragma once

#include "core/kernels/conv_plan.h"

namespace opaline::kernels {

/// Whether images of these parts can be read and written in place: all but the last have whole vectors of
/// channels.
template <class T>
bool winograd_takes(Parts<T> parts);

/// `outputs` as winograd_fits() allows: m of F(m x m, 3 x 3), or 3 for F(3 x 3, 4 x 4). Other arguments as in
/// conv.h.
template <class T>
void winograd_forward(int outputs, const ConvShape& s, Parts<const T> x, const T* weight, const T* bias, T* y,
                      const ConvSites& sites = {});

/// With s.reflect, dx is the gradient of the padded image, n x (h + 2 padding) x (w + 2 padding) x in, and
/// sites.x are those of that image.
template <class T>
void winograd_input_gradient(int outputs, const ConvShape& s, const T* dy, const T* weight, const T* bias,
                             Parts<T> dx, const ConvSites& sites = {});

template <class T>
void winograd_weight_gradient(int outputs, const ConvShape& s, Parts<const T> x, const T* dy, T* dweight,
                              const ConvSites& sites = {});

}  // namespace opaline::kernels
