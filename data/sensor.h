// A scene as a camera records it: exposure, white balance and, where asked for, what a real polarisation
// sensor adds. Applied at load, so that files stay clean; a pure function of (seed, epoch, sample).
//
// The light of a colour is multiplied by k w (exposure and white balance), and the SH labels with it; the
// flash, which is grey, takes the mean of the three. k is limited so that the flash stays in its range, 35
// to 75. Then, in a sensor's order: S1 and S2 times the extinction factor; the analyser of each angle turned
// by its error; each angle sampled where its pixel of the 2 x 2 cell is (90, 45 / 135, 0), half a pixel from
// its neighbours; the gain of each angle; noise of variance c I; clipping to [0, 1]; truncation to 8 bits of
// I^(1/2.2), which readers undo in the middle of a level. Stokes, max and min are computed from what remains.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "data/scene.h"
#include "data/window.h"

namespace opaline {

/// Strengths; fitted to the released captures.
struct SensorOptions {
  bool on = false;
  std::array<double, 3> noise = {5e-5, 4.5e-5, 8e-5};  ///< variance over I, of R, G, B
  double gain = 0.015;                                 ///< of each angle, at most 1 -+ this
  double angle = 1.0;                                  ///< error of each polariser, degrees, at most -+ this
  double extinction = 0.97;     ///< S1 and S2 are multiplied by this at least, 1 at most
  double white_balance = 0.05;  ///< gain of each colour, at most 1 -+ this
  bool mosaic = true;           ///< angles are sampled half a pixel apart
  bool truncate = true;         ///< to 8 bits
};

struct CaptureOptions {
  std::array<double, 2> exposure = {1.0, 1.0};  ///< k is drawn from here, log-uniform
  SensorOptions sensor;

  /// Scenes pass as they are.
  bool off() const { return !sensor.on && exposure == std::array{1.0, 1.0}; }
};

/// What was drawn for one scene. The default changes nothing but clipping.
struct Shot {
  std::array<float, 3> gain = {1.0F, 1.0F, 1.0F};  ///< k w, of R, G, B
  bool sensor = false;                             ///< whether what follows counts
  std::array<float, 4> angle_gain = {1.0F, 1.0F, 1.0F, 1.0F};
  /// Factors of S1 and S2: extinction times cos and sin of twice the analyser's angle; 0, 45, 90, 135
  /// degrees.
  std::array<std::array<float, 2>, 4> analyser = {{{1.0F, 0.0F}, {0.0F, 1.0F}, {-1.0F, 0.0F}, {0.0F, -1.0F}}};
  std::array<float, 3> noise{};  ///< variance over I
  bool mosaic = false;
  bool truncate = false;
  uint64_t seed = 0;  ///< of the noise, with the next two
  uint32_t epoch = 0;
  uint32_t sample = 0;

  /// An exposure alone.
  static Shot exposed(float k) { return {.gain = {k, k, k}}; }
  /// The factor of the flash.
  float flash_gain() const { return (gain[0] + gain[1] + gain[2]) / 3.0F; }
};

/// Of a scene whose flash has this radiance; without one k is limited by `exposure` alone. Where the limits
/// of k do not meet, those of the flash win.
Shot draw_shot(const CaptureOptions& options, uint64_t seed, int64_t epoch, int64_t sample,
               const std::optional<float>& flash);

/// A Stokes image or the part of it that was read: window height x window width x 9.
struct StokesView {
  const float* values = nullptr;
  Window window;
  int width = 0;  ///< of the whole image
  int height = 0;
};

/// A pixel, by its place in the whole image and in the window.
struct PixelIndex {
  int32_t image = 0;
  int32_t window = 0;
};

inline constexpr size_t kPixelBlock = 256;
/// Twelve planes: angle by angle R, G, B.
using PolariserBlock = std::array<std::array<float, kPixelBlock>, 12>;

/// Which image of a scene: each has its own noise.
enum class Layer : uint32_t { kImage = 0, kBsdf = 1 };

/// The polariser images of up to kPixelBlock pixels, clipped to [0, 1]. With a mosaic, neighbours are read:
/// where the window is not the image, pixels must be one off its border.
void photograph(const StokesView& image, const Shot& shot, Layer layer, std::span<const PixelIndex> pixels,
                PolariserBlock& block);

}  // namespace opaline
