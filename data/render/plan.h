// How many samples each part of each pixel gets.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

namespace opaline::render {

/// Parts of a pixel that are estimated apart.
inline constexpr size_t kPixelParts = 3;  // mirror, unscattered, scattered

/// What pilot samples of one pixel tell.
struct PixelPilot {
  bool object = false;  ///< some sample met it
  bool whole = false;   ///< every sample met it
  double light = 0.0;   ///< S0 up to white, mean over colours
  /// Variance of one sample of each part: of S0, mean over colours (0 over white) ..
  std::array<double, kPixelParts> s0{};
  /// .. and of the degree of polarisation that it is part of, to first order.
  std::array<double, kPixelParts> dop{};
  /// The same of what one light path brings to this pixel.
  double light_path_s0 = 0.0;
  double light_path_dop = 0.0;
};

/// Numbers of samples.
using PartCounts = std::array<int64_t, kPixelParts>;

struct PlanOptions {
  double error = 0.03;  ///< wanted root-mean-square error of S0 over the object, relative to its mean there
  double dop_error = 0.0;  ///< the same of the degree of polarisation, absolute; 0: any
  std::array<double, kPixelParts> cost = {1.0, 1.0, 1.0};  ///< of one sample
  double light_path_cost = 1.0;
  PartCounts least = {4, 4, 4};
  int64_t most = 1 << 16;
  bool parts = true;   ///< each part its own number
  bool pixels = true;  ///< each pixel its own number
};

struct SamplePlan {
  std::vector<PartCounts> pixels;  ///< row by row; zero off the object
  int64_t light_paths = 0;         ///< which serve all pixels
};

/// Counts that reach both errors at the least cost: in proportion to the root of variance / cost (Neyman's
/// allocation). Variances are averaged over 3 x 3 pixels first, as a few samples tell little of rare bright
/// ones.
SamplePlan plan_samples(const std::vector<PixelPilot>& pilots, int width, int height,
                        const PlanOptions& options);

}  // namespace opaline::render
