// Time and error of single convolutions, algorithm by algorithm: what `opaline bench conv` and `opaline bench
// layers` print.
#pragma once

#include <string>
#include <vector>

#include "core/kernels/conv.h"
#include "core/tensor.h"

namespace opaline::cli {

/// An algorithm for one pass: Winograd's with tiles of `outputs` a side, or the direct one (0).
struct ConvTiming {
  kernels::ConvPass pass{};
  int outputs = 0;
  double seconds = 0.0;  ///< median
  double gflops = 0.0;   ///< by the direct count
  double error = 0.0;    ///< root mean square against float64, relative to the root mean square of that
};

struct ConvData {
  kernels::ConvShape shape;
  Tensor x, weight, dy;  ///< float32, N x H x W x C and O x I x KH x KW
};

/// Every algorithm that fits the shape, for the three passes. All run before any is timed; then they take
/// turns `repeats` times.
std::vector<ConvTiming> measure_conv(const ConvData& data, int repeats);

/// "direct", "F(4x4)".
std::string algorithm_name(int outputs);

}  // namespace opaline::cli
