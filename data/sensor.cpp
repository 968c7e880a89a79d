#include "data/sensor.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/random.h"
#include "data/gamma.h"

namespace opaline {
namespace {

constexpr double kMinFlash = 35.0;
constexpr double kMaxFlash = 75.0;
constexpr size_t kNormals = 12;  // a pixel

/// Where each angle's pixel is in the cell, from its middle: 90, 45 / 135, 0.
constexpr std::array<std::array<int, 2>, 4> kCell = {{{1, 1}, {1, -1}, {-1, -1}, {-1, 1}}};
// A quarter of a pixel from the middle, so half a pixel from one another.
constexpr float kShift = 0.25F;

/// Twelve standard normals, a function of the pixel alone (Box-Muller on three Philox blocks): whatever part
/// of the image was read, in whatever order, a pixel has its noise.
std::array<float, kNormals> pixel_noise(const Shot& shot, Layer layer, int32_t pixel) {
  const std::array<uint32_t, 2> key = {static_cast<uint32_t>(shot.seed),
                                       static_cast<uint32_t>(shot.seed >> 32)};
  // The second word keeps these apart from the stream that the shot itself was drawn from.
  const uint32_t purpose = static_cast<uint32_t>(Purpose::kSensor) | (static_cast<uint32_t>(layer) + 1U)
                                                                         << 16U;
  std::array<float, kNormals> normals{};
  for (uint32_t block = 0; block < 3; ++block) {
    const auto words =
        philox({3U * static_cast<uint32_t>(pixel) + block, purpose, shot.epoch, shot.sample}, key);
    for (size_t pair = 0; pair < 2; ++pair) {
      const float u = (static_cast<float>(words[2 * pair] >> 8U) + 0.5F) * 0x1p-24F;  // in (0, 1)
      const float v = static_cast<float>(words[2 * pair + 1] >> 8U) * 0x1p-24F;
      const float radius = std::sqrt(-2.0F * std::log(u));
      const float angle = 2.0F * std::numbers::pi_v<float> * v;
      normals[4 * block + 2 * pair] = radius * std::cos(angle);
      normals[4 * block + 2 * pair + 1] = radius * std::sin(angle);
    }
  }
  return normals;
}

/// Nine Stokes values a quarter of a pixel off, bilinear.
std::array<float, kStokesChannels> shifted(const StokesView& image, int32_t at,
                                           const std::array<int, 2>& to) {
  const int x = at % image.window.width();
  const int y = at / image.window.width();
  const int x2 = std::clamp(x + to[0], 0, image.window.width() - 1);
  const int y2 = std::clamp(y + to[1], 0, image.window.height() - 1);
  const auto pixel = [&](int px, int py) {
    return image.values + (static_cast<int64_t>(py) * image.window.width() + px) * kStokesChannels;
  };
  const float* const here = pixel(x, y);
  const float* const beside = pixel(x2, y);
  const float* const below = pixel(x, y2);
  const float* const across = pixel(x2, y2);
  std::array<float, kStokesChannels> s{};
  for (size_t i = 0; i < s.size(); ++i) {
    const float row = here[i] + kShift * (beside[i] - here[i]);
    const float next = below[i] + kShift * (across[i] - below[i]);
    s[i] = row + kShift * (next - row);
  }
  return s;
}

void record_sensor(const StokesView& image, const Shot& shot, Layer layer, std::span<const PixelIndex> pixels,
                   PolariserBlock& block) {
  const bool noisy = shot.noise != std::array{0.0F, 0.0F, 0.0F};
  for (size_t k = 0; k < pixels.size(); ++k) {
    std::array<float, kNormals> normals{};
    if (noisy) normals = pixel_noise(shot, layer, pixels[k].image);
    const float* const here = image.values + int64_t{pixels[k].window} * kStokesChannels;
    std::array<float, kStokesChannels> s{};
    if (!shot.mosaic) std::copy(here, here + kStokesChannels, s.begin());
    for (size_t angle = 0; angle < 4; ++angle) {
      if (shot.mosaic) s = shifted(image, pixels[k].window, kCell[angle]);
      const auto& [cosine, sine] = shot.analyser[angle];
      for (size_t c = 0; c < 3; ++c) {
        const float light =
            shot.gain[c] * shot.angle_gain[angle] * 0.5F * (s[c] + cosine * s[3 + c] + sine * s[6 + c]);
        const float spread = std::sqrt(shot.noise[c] * std::max(light, 0.0F));
        block[3 * angle + c][k] = std::clamp(light + spread * normals[3 * angle + c], 0.0F, 1.0F);
      }
    }
  }
  if (!shot.truncate) return;
  for (auto& plane : block) {
    encode_8bit({plane.data(), pixels.size()}, plane.data());
    for (size_t k = 0; k < pixels.size(); ++k) plane[k] = decode_8bit(static_cast<uint8_t>(plane[k]));
  }
}

void record_clean(const StokesView& image, const Shot& shot, std::span<const PixelIndex> pixels,
                  PolariserBlock& block) {
  const size_t n = pixels.size();
  std::array<std::array<float, kPixelBlock>, kStokesChannels> s;
  for (size_t k = 0; k < n; ++k) {
    const float* const from = image.values + int64_t{pixels[k].window} * kStokesChannels;
    for (size_t i = 0; i < kStokesChannels; ++i) s[i][k] = from[i];
  }
  const auto clip = [](float x) { return std::min(std::max(x, 0.0F), 1.0F); };
  for (size_t c = 0; c < 3; ++c) {
    const float gain = shot.gain[c];
    for (size_t k = 0; k < n; ++k) {
      block[c][k] = clip(gain * (s[c][k] + s[3 + c][k]) / 2.0F);
      block[3 + c][k] = clip(gain * (s[c][k] + s[6 + c][k]) / 2.0F);
      block[6 + c][k] = clip(gain * (s[c][k] - s[3 + c][k]) / 2.0F);
      block[9 + c][k] = clip(gain * (s[c][k] - s[6 + c][k]) / 2.0F);
    }
  }
}

}  // namespace

Shot draw_shot(const CaptureOptions& options, uint64_t seed, int64_t epoch, int64_t sample,
               const std::optional<float>& flash) {
  if (options.off()) return {};
  const SensorOptions& sensor = options.sensor;
  Shot shot{.seed = seed, .epoch = static_cast<uint32_t>(epoch), .sample = static_cast<uint32_t>(sample)};
  Random random(seed, Purpose::kSensor, shot.epoch, shot.sample);
  // Always drawn, in this order: switching one strength off leaves the others' numbers as they are.
  const double share = random.uniform();
  const auto around_one = [&](double most) { return 1.0 + most * random.uniform(-1.0, 1.0); };
  std::array<double, 3> balance{};
  for (double& w : balance) w = around_one(sensor.on ? sensor.white_balance : 0.0);
  const double mean = (balance[0] + balance[1] + balance[2]) / 3.0;

  double low = options.exposure[0];
  double high = options.exposure[1];
  if (flash && *flash > 0.0F) {
    const double flash_low = kMinFlash / (static_cast<double>(*flash) * mean);
    const double flash_high = kMaxFlash / (static_cast<double>(*flash) * mean);
    low = std::clamp(low, flash_low, flash_high);
    high = std::clamp(high, flash_low, flash_high);
  }
  const double k = low * std::pow(high / low, share);
  for (size_t c = 0; c < 3; ++c) shot.gain[c] = static_cast<float>(k * balance[c]);
  if (!sensor.on) return shot;

  shot.sensor = true;
  const double extinction = random.uniform(sensor.extinction, 1.0);
  for (size_t angle = 0; angle < 4; ++angle) {
    shot.angle_gain[angle] = static_cast<float>(around_one(sensor.gain));
    const double degrees = 45.0 * static_cast<double>(angle) + sensor.angle * random.uniform(-1.0, 1.0);
    const double twice = 2.0 * degrees * std::numbers::pi / 180.0;
    shot.analyser[angle] = {static_cast<float>(extinction * std::cos(twice)),
                            static_cast<float>(extinction * std::sin(twice))};
  }
  for (size_t c = 0; c < 3; ++c) shot.noise[c] = static_cast<float>(sensor.noise[c]);
  shot.mosaic = sensor.mosaic;
  shot.truncate = sensor.truncate;
  return shot;
}

void photograph(const StokesView& image, const Shot& shot, Layer layer, std::span<const PixelIndex> pixels,
                PolariserBlock& block) {
  if (shot.sensor) {
    record_sensor(image, shot, layer, pixels, block);
  } else {
    record_clean(image, shot, pixels, block);
  }
}

}  // namespace opaline
