// Light as layouts of polariser images store it, before readers repair or convert anything.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

namespace opaline {

/// Four polariser images in linear light, 0, 45, 90 and 135 degrees; each H x W x 3.
struct PolariserImages {
  int width = 0;
  int height = 0;
  std::array<std::vector<float>, 4> images;
  std::vector<uint8_t> clipped;  ///< H x W x 3: 1 where one of the four is too bright to tell

  int64_t pixels() const { return int64_t{width} * height; }
};

struct StoredLight {
  PolariserImages polarisers;
  /// s0.npy, s1.npy, s2.npy as they are, H x W x 3; empty where there are none.
  std::array<std::vector<float>, 3> stokes;
};

}  // namespace opaline
