// What a few samples, thrown away afterwards, tell of a pixel's noise.
#pragma once

#include "data/render/light_paths.h"
#include "data/render/path.h"
#include "data/render/plan.h"

namespace opaline::render {

/// What light paths have brought to one pixel.
class LightPilot {
 public:
  void add(const Splat& splat);
  void add(const LightPilot& other);
  /// Light of one path: its mean, and the mean of component i x component j of a colour.
  double mean(size_t i, size_t c, double paths) const { return sum_[i][c] / paths; }
  double second_moment(size_t c, size_t i, size_t j, double paths) const { return product_[c][i][j] / paths; }

 private:
  StokesRgb sum_{};
  std::array<std::array<std::array<double, 3>, 3>, 3> product_{};  // colour, components
};

/// One pixel's camera paths.
class CameraPilot {
 public:
  void add(const PathSample& sample);
  /// Together with what `paths` light paths have brought to the pixel and, for their mean, to all of
  /// `around`; none if `paths` is 0.
  PixelPilot result(const LightPilot& light, const LightPilot& around, double pixels_around,
                    int64_t paths) const;

 private:
  int64_t count_ = 0, hits_ = 0;
  std::array<StokesRgb, kPixelParts> sum_{};
  // part, colour, components
  std::array<std::array<std::array<std::array<double, 3>, 3>, 3>, kPixelParts> product_{};
};

}  // namespace opaline::render
