#include "data/encode.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <numbers>
#include <numeric>

#include "core/error.h"

namespace opaline {
namespace {

constexpr float kGamma = 2.2F;
constexpr int64_t kPolariserChannels = 12;

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

using Rgb = std::array<float, 3>;

/// One pixel's light, clipped, and what follows from it.
struct Light {
  std::array<Rgb, 4> pol;     ///< I0, I45, I90, I135
  std::array<Rgb, 3> stokes;  ///< of the clipped images
};

float clip(float x) {
  return std::min(std::max(x, 0.0F), 1.0F);
}

/// Polariser images of one pixel's nine Stokes values.
std::array<Rgb, 4> polarisers(const float* s, float exposure) {
  std::array<Rgb, 4> pol{};
  for (size_t c = 0; c < 3; ++c) {
    const float s0 = s[c];
    const float s1 = s[3 + c];
    const float s2 = s[6 + c];
    pol[0][c] = clip(exposure * (s0 + s1) / 2.0F);
    pol[1][c] = clip(exposure * (s0 + s2) / 2.0F);
    pol[2][c] = clip(exposure * (s0 - s1) / 2.0F);
    pol[3][c] = clip(exposure * (s0 - s2) / 2.0F);
  }
  return pol;
}

Light light_of(const float* s, float exposure) {
  Light light{.pol = polarisers(s, exposure), .stokes = {}};
  for (size_t c = 0; c < 3; ++c) {
    light.stokes[0][c] = (light.pol[0][c] + light.pol[1][c] + light.pol[2][c] + light.pol[3][c]) / 2.0F;
    light.stokes[1][c] = light.pol[0][c] - light.pol[2][c];
    light.stokes[2][c] = light.pol[1][c] - light.pol[3][c];
  }
  return light;
}

/// 2 v - 1 of the encoded value.
float network_value(float linear, bool quantise) {
  float v = encode_gamma(linear);
  if (quantise) v = std::floor(255.0F * v) / 255.0F;
  return 2.0F * v - 1.0F;
}

/// Writes the values of one input at one pixel and moves `out` behind them.
class PixelWriter {
 public:
  PixelWriter(const EncodeOptions& options, float* out) : options_(options), out_(out) {}

  void write(InputKind kind, const Light& light, bool object) {
    switch (kind) {
      case InputKind::kIntensity:
        for (const float s0 : light.stokes[0]) put(network_value(s0 / 2.0F, options_.quantise));
        return;
      case InputKind::kPol4:
        for (const Rgb& image : light.pol) intensity(image, object);
        return;
      case InputKind::kMaxMin:
        intensity(extreme(light, options_.min_first ? -1.0F : 1.0F), object);
        intensity(extreme(light, options_.min_first ? 1.0F : -1.0F), object);
        return;
      case InputKind::kDopAop:
        for (size_t c = 0; c < 3; ++c) put(dop(light, c));
        for (size_t c = 0; c < 3; ++c) put(aop(light, c));
        return;
      case InputKind::kEncodedAop:
        for (size_t c = 0; c < 3; ++c) put(double_angle(light, c)[0]);
        for (size_t c = 0; c < 3; ++c) put(double_angle(light, c)[1]);
        return;
      case InputKind::kStokes:
        for (const Rgb& s : light.stokes) {
          for (const float value : s) put(value);
        }
        return;
      case InputKind::kMask:
        put(object ? 1.0F : -1.0F);
        return;
      case InputKind::kBackground:
        intensity(light.pol[0], !object);
        return;
    }
  }

 private:
  void put(float value) { *out_++ = value; }

  /// Masked pixels cost no power function: they are black.
  void intensity(const Rgb& linear, bool shown) {
    for (const float value : linear) put(shown ? network_value(value, options_.quantise) : -1.0F);
  }

  static float length(const Light& light, size_t c) {
    return std::hypot(light.stokes[1][c], light.stokes[2][c]);
  }
  static Rgb extreme(const Light& light, float sign) {
    Rgb value{};
    for (size_t c = 0; c < 3; ++c) value[c] = (light.stokes[0][c] + sign * length(light, c)) / 2.0F;
    return value;
  }
  static float dop(const Light& light, size_t c) {
    return light.stokes[0][c] > 0.0F ? length(light, c) / light.stokes[0][c] : 0.0F;
  }
  static float aop(const Light& light, size_t c) {
    constexpr float kPi = std::numbers::pi_v<float>;
    if (light.stokes[1][c] == 0.0F && light.stokes[2][c] == 0.0F) return 0.0F;
    const float angle = 0.5F * std::atan2(light.stokes[2][c], light.stokes[1][c]);
    const float positive = angle < 0.0F ? angle + kPi : angle;
    return positive < kPi ? positive : 0.0F;  // a tiny negative angle plus pi rounds to pi
  }
  static std::array<float, 2> double_angle(const Light& light, size_t c) {
    const float norm = length(light, c);
    if (!(norm > 0.0F)) return {1.0F, 0.0F};
    return {light.stokes[1][c] / norm, light.stokes[2][c] / norm};
  }

  const EncodeOptions& options_;
  float* out_;
};

void check_scene(const Scene& scene) {
  constexpr int kMultiple = 16;
  constexpr int kSmallest = 32;
  const auto fits = [](int n) { return n >= kSmallest && n % kMultiple == 0; };
  if (!fits(scene.width) || !fits(scene.height)) {
    const auto near = [&](int n) { return std::max(kSmallest, n / kMultiple * kMultiple); };
    fail(scene.source,
         "scene {} has {} x {} pixels; the networks take multiples of {} from {} on: crop or "
         "resize it to {} x {}",
         scene.id, scene.width, scene.height, kMultiple, kSmallest, near(scene.width), near(scene.height));
  }
  const auto pixels = static_cast<size_t>(scene.pixels());
  if (scene.image.size() != pixels * kStokesChannels || scene.mask.size() != pixels) {
    fail(scene.source, "scene {} has {} image and {} mask values for {} pixels", scene.id, scene.image.size(),
         scene.mask.size(), pixels);
  }
}

/// The four polariser images encoded: H x W x 12. Without a mask everything shows.
Tensor encode_polarisers(std::span<const float> stokes, const Scene& scene, std::span<const uint8_t> mask,
                         bool quantise, float exposure) {
  Tensor result({scene.height, scene.width, kPolariserChannels});
  float* out = result.data<float>();
  for (int64_t i = 0; i < scene.pixels(); ++i) {
    const bool shown = mask.empty() || mask[static_cast<size_t>(i)] != 0;
    const std::array<Rgb, 4> pol = polarisers(stokes.data() + i * kStokesChannels, exposure);
    for (const Rgb& image : pol) {
      for (const float value : image) *out++ = shown ? network_value(value, quantise) : -1.0F;
    }
  }
  return result;
}

Tensor masked(const std::vector<float>& values, const Scene& scene, int64_t channels) {
  if (values.empty()) return {};
  Tensor result = Tensor::zeros({scene.height, scene.width, channels});
  float* out = result.data<float>();
  for (int64_t i = 0; i < scene.pixels(); ++i) {
    if (scene.mask[static_cast<size_t>(i)] == 0) continue;
    const float* from = values.data() + i * channels;
    std::copy(from, from + channels, out + i * channels);
  }
  return result;
}

Tensor vector_of(const std::vector<float>& values) {
  return Tensor::from<float>(std::span<const float>(values), {static_cast<int64_t>(values.size())});
}

Tensor illumination_target(const Scene& scene, const EncodeOptions& options, float exposure) {
  if (!scene.sh || (options.flash_in_illumination && !scene.flash)) return {};
  std::vector<float> values(scene.sh->begin(), scene.sh->end());
  for (float& value : values) value *= exposure;
  if (options.flash_in_illumination) values.push_back(map_flash(*scene.flash * exposure));
  return vector_of(values);
}

Tensor sss_target(const Scene& scene, const EncodeOptions& options, float exposure) {
  if (!scene.g || !scene.sigma_t || !scene.albedo || (options.flash_in_sss && !scene.flash)) return {};
  std::vector<float> values = {map_g(*scene.g)};
  for (const float x : *scene.sigma_t) values.push_back(map_sigma_t(x));
  for (const float x : *scene.albedo) values.push_back(map_albedo(x));
  if (options.flash_in_sss) values.push_back(map_flash(*scene.flash * exposure));
  return vector_of(values);
}

/// One field of all samples on top of each other; undefined where it is in all of them.
Tensor stack(std::span<const Sample> samples, Tensor Sample::*field, std::string_view name) {
  const Tensor& first = samples.front().*field;
  for (const Sample& sample : samples) {
    const Tensor& tensor = sample.*field;
    if (tensor.defined() != first.defined()) {
      fail("make_batch", "of scenes {} and {} only one has {}", samples.front().id, sample.id, name);
    }
    if (tensor.defined() && tensor.shape() != first.shape()) {
      fail("make_batch", "{} of scene {} is {}, of scene {} {}: scenes of a batch need one size", name,
           samples.front().id, to_string(first.shape()), sample.id, to_string(tensor.shape()));
    }
  }
  if (!first.defined()) return {};
  Shape shape = first.shape();
  shape.insert(shape.begin(), static_cast<int64_t>(samples.size()));
  Tensor result(shape, first.dtype());
  std::byte* to = result.bytes();
  for (const Sample& sample : samples) {
    const Tensor& tensor = sample.*field;
    std::memcpy(to, tensor.bytes(), static_cast<size_t>(tensor.byte_size()));
    to += tensor.byte_size();
  }
  return result;
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

Sample encode_scene(const Scene& scene, const EncodeOptions& options, const EncodeWanted& wanted,
                    float exposure) {
  check_scene(scene);
  Sample sample;
  sample.id = scene.id;
  const int64_t channels = input_channels(options);
  if (channels == 0) fail_usage("inputs", "the list of inputs is empty");
  sample.input = Tensor({scene.height, scene.width, channels});
  sample.mask = Tensor({scene.height, scene.width, 1});
  float* out = sample.input.data<float>();
  float* mask = sample.mask.data<float>();
  for (int64_t i = 0; i < scene.pixels(); ++i) {
    const bool object = scene.mask[static_cast<size_t>(i)] != 0;
    const Light light = light_of(scene.image.data() + i * kStokesChannels, exposure);
    PixelWriter writer(options, out + i * channels);
    for (const InputKind kind : options.inputs) writer.write(kind, light, object);
    mask[i] = object ? 1.0F : 0.0F;
  }
  if (wanted.targets) {
    sample.normal = masked(scene.normal, scene, 3);
    sample.depth = masked(scene.depth, scene, 1);
    sample.illumination = illumination_target(scene, options, exposure);
    sample.sss = sss_target(scene, options, exposure);
  }
  if (wanted.reconstruction) {
    sample.polarised = encode_polarisers(scene.image, scene, scene.mask, options.quantise, exposure);
    if (!scene.bsdf.empty()) {
      sample.bsdf = encode_polarisers(scene.bsdf, scene, {}, options.quantise, exposure);
    }
  }
  return sample;
}

Batch make_batch(std::span<const Sample> samples) {
  if (samples.empty()) fail("make_batch", "no samples");
  Batch batch;
  for (const Sample& sample : samples) batch.ids.push_back(sample.id);
  batch.input = stack(samples, &Sample::input, "input");
  batch.normal = stack(samples, &Sample::normal, "normal");
  batch.depth = stack(samples, &Sample::depth, "depth");
  batch.mask = stack(samples, &Sample::mask, "mask");
  batch.illumination = stack(samples, &Sample::illumination, "illumination");
  batch.sss = stack(samples, &Sample::sss, "SSS values");
  batch.bsdf = stack(samples, &Sample::bsdf, "pure-BSDF images");
  batch.polarised = stack(samples, &Sample::polarised, "polarised images");
  return batch;
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
  const float clipped = clip(linear);
  return clipped == 0.0F ? 0.0F : std::pow(clipped, 1.0F / kGamma);
}

float decode_gamma(float encoded) {
  return encoded <= 0.0F ? 0.0F : std::pow(encoded, kGamma);
}

std::vector<float> polariser_images(std::span<const float> stokes, float exposure) {
  const size_t pixels = stokes.size() / kStokesChannels;
  std::vector<float> images;
  images.reserve(pixels * kPolariserChannels);
  for (size_t i = 0; i < pixels; ++i) {
    for (const Rgb& image : polarisers(stokes.data() + i * kStokesChannels, exposure)) {
      images.insert(images.end(), image.begin(), image.end());
    }
  }
  return images;
}

uint8_t to_byte(float value) {
  return static_cast<uint8_t>(std::lround(255.0F * clip(value)));
}

}  // namespace opaline
