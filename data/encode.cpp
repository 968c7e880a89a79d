#include "data/encode.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/error.h"
#include "data/gamma.h"

namespace opaline {
namespace {

constexpr float kGamma = 2.2F;
constexpr size_t kPolariserChannels = 12;

// Physical ranges that the targets' [-1, 1] stands for.
constexpr float kMaxG = 0.9F;
constexpr float kMaxSigmaT = 32.0F;
constexpr float kMinAlbedo = 0.3F;
constexpr float kMaxAlbedo = 0.95F;
constexpr float kMinFlash = 35.0F;
constexpr float kMaxFlash = 75.0F;

constexpr float to_unit(float value, float low, float high) {
  return 2.0F * (value - low) / (high - low) - 1.0F;
}
constexpr float from_unit(float mapped, float low, float high) {
  return low + (mapped + 1.0F) / 2.0F * (high - low);
}

struct InputName {
  InputKind kind;
  std::string_view name;
  int64_t channels;
};

constexpr std::array<InputName, 8> kInputs = {{{InputKind::kIntensity, "intensity", 3},
                                               {InputKind::kPol4, "pol4", 12},
                                               {InputKind::kMaxMin, "maxmin", 6},
                                               {InputKind::kDopAop, "dop_aop", 6},
                                               {InputKind::kEncodedAop, "encoded_aop", 6},
                                               {InputKind::kStokes, "stokes", 9},
                                               {InputKind::kMask, "mask", 1},
                                               {InputKind::kBackground, "background", 3}}};

const InputName& entry(InputKind kind) {
  return *std::find_if(kInputs.begin(), kInputs.end(), [&](const InputName& e) { return e.kind == kind; });
}

}  // namespace

std::string_view to_string(InputKind kind) {
  return entry(kind).name;
}

InputKind parse_input_kind(std::string_view name) {
  std::string known;
  for (const InputName& e : kInputs) {
    if (e.name == name) return e.kind;
    known += (known.empty() ? "" : ", ") + std::string(e.name);
  }
  fail_usage("inputs", "unknown input '{}'; known: {}", name, known);
}

int64_t channels_of(InputKind kind) {
  return entry(kind).channels;
}

EncodeOptions EncodeOptions::paper() {
  return {.inputs = {InputKind::kPol4, InputKind::kMaxMin, InputKind::kMask}};
}

EncodeOptions EncodeOptions::release() {
  return {.inputs = {InputKind::kPol4, InputKind::kBackground, InputKind::kMaxMin},
          .min_first = true,
          .quantise = true,
          .flash_in_illumination = false,
          .flash_in_sss = true};
}

int64_t input_channels(const EncodeOptions& options) {
  return std::accumulate(options.inputs.begin(), options.inputs.end(), int64_t{0},
                         [](int64_t sum, InputKind kind) { return sum + channels_of(kind); });
}

int64_t illumination_values(const EncodeOptions& options) {
  return kShValues + (options.flash_in_illumination ? 1 : 0);
}

int64_t sss_values(const EncodeOptions& options) {
  return 7 + (options.flash_in_sss ? 1 : 0);
}

float map_g(float g) {
  return to_unit(g, 0.0F, kMaxG);
}
float map_sigma_t(float per_metre) {
  return to_unit(per_metre, 0.0F, kMaxSigmaT);
}
float map_albedo(float albedo) {
  return to_unit(albedo, kMinAlbedo, kMaxAlbedo);
}
float map_flash(float radiance) {
  return to_unit(radiance, kMinFlash, kMaxFlash);
}
float unmap_g(float mapped) {
  return from_unit(mapped, 0.0F, kMaxG);
}
float unmap_sigma_t(float mapped) {
  return from_unit(mapped, 0.0F, kMaxSigmaT);
}
float unmap_albedo(float mapped) {
  return from_unit(mapped, kMinAlbedo, kMaxAlbedo);
}
float unmap_flash(float mapped) {
  return from_unit(mapped, kMinFlash, kMaxFlash);
}

SssValues decode_sss(std::span<const float> mapped) {
  if (mapped.size() != 7 && mapped.size() != 8)
    fail("decode_sss", "{} values; 7 or 8 expected", mapped.size());
  SssValues values;
  values.g = unmap_g(mapped[0]);
  for (size_t c = 0; c < 3; ++c) {
    values.sigma_t[c] = unmap_sigma_t(mapped[1 + c]);
    values.albedo[c] = unmap_albedo(mapped[4 + c]);
  }
  if (mapped.size() == 8) values.flash = unmap_flash(mapped[7]);
  return values;
}

float encode_gamma(float linear) {
  float encoded = 0.0F;
  encode_gamma({&linear, 1}, &encoded);
  return encoded;
}

float decode_gamma(float encoded) {
  return encoded <= 0.0F ? 0.0F : std::pow(encoded, kGamma);
}

std::vector<float> polariser_images(std::span<const float> stokes, float exposure) {
  const size_t pixels = stokes.size() / kStokesChannels;
  std::vector<float> images(pixels * kPolariserChannels);
  std::vector<PixelIndex> block;
  PolariserBlock planes;
  const StokesView view{stokes.data(), {0, 0, static_cast<int>(pixels), 1}, static_cast<int>(pixels), 1};
  for (size_t begin = 0; begin < pixels; begin += kPixelBlock) {
    block.clear();
    for (size_t i = begin; i < std::min(pixels, begin + kPixelBlock); ++i) {
      block.push_back({static_cast<int32_t>(i), static_cast<int32_t>(i)});
    }
    photograph(view, Shot::exposed(exposure), Layer::kImage, block, planes);
    for (size_t k = 0; k < block.size(); ++k) {
      for (size_t c = 0; c < kPolariserChannels; ++c)
        images[(begin + k) * kPolariserChannels + c] = planes[c][k];
    }
  }
  return images;
}

uint8_t to_byte(float value) {
  return static_cast<uint8_t>(std::lround(255.0F * std::clamp(value, 0.0F, 1.0F)));
}

}  // namespace opaline
