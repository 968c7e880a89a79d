// One scene in memory, whatever layout it was read from: linear light, our conventions.
//
// Conventions. Images are rows of pixels from the top left, channels last. S1 = I0 - I90, S2 = I45 - I135,
// 0 degrees along the image's x axis, angles counter-clockwise as seen in the image; I = 1 (S0 = 2) is white.
// Normals and SH are in camera axes (x right, y up, z towards the camera); depth is z / 0.25 m, larger is
// nearer. SH: real, orthonormal, no Condon-Shortley sign, order (0,0) (1,-1) (1,0) (1,1) (2,-2) .. (2,2).
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "data/window.h"

namespace opaline {

/// Channels of a Stokes image: S0.R S0.G S0.B S1.R .. S2.B.
inline constexpr int kStokesChannels = 9;
/// Spherical-harmonics coefficients: three colours x nine, colour-major.
inline constexpr int kShValues = 27;

struct Scene {
  std::string id;      ///< unique in its split
  std::string source;  ///< file or folder it was read from, for messages
  int width = 0;
  int height = 0;

  std::vector<float> image;   ///< H x W x 9 linear Stokes; of the window alone where there is one
  std::vector<float> bsdf;    ///< without the medium; empty where absent or not asked for
  std::vector<float> normal;  ///< H x W x 3, unit inside the mask; empty where absent or not asked for
  std::vector<float> depth;   ///< H x W; empty where absent or not asked for
  std::vector<uint8_t> mask;  ///< H x W, 1 on the object

  std::optional<std::array<float, kShValues>> sh;  ///< environment radiance without the flash
  std::optional<float> flash;                      ///< radiance of the flash, 35 to 75
  std::optional<std::array<float, 3>> sigma_t;     ///< extinction per metre, 0 to 32
  std::optional<std::array<float, 3>> albedo;      ///< single-scattering albedo
  std::optional<float> g;                          ///< Henyey-Greenstein

  /// Set by readers that had to repair something worth reporting: (I45 + I135) / (I0 + I90) before the pairs
  /// were equalised.
  std::optional<float> pair_ratio;

  /// What `image` covers, where less than the whole was read (LoadOptions::whole).
  std::optional<Window> window;
  /// What `bsdf`, `normal` and `depth` cover, where less than the whole was read (LoadOptions::support).
  std::optional<Window> object;

  Window image_window() const { return window.value_or(Window{0, 0, width, height}); }
  Window object_window() const { return object.value_or(Window{0, 0, width, height}); }
  int64_t pixels() const { return int64_t{width} * height; }
  /// Bytes of pixels held.
  int64_t byte_size() const;
};

}  // namespace opaline
