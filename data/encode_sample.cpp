// Samples and batches: which tensors there are, and filling them.
#include <algorithm>
#include <cstring>

#include "core/error.h"
#include "data/encode.h"
#include "data/encode_images.h"

namespace opaline {
namespace {

constexpr int64_t kPolariserChannels = 12;

struct Field {
  std::string_view name;
  Tensor Sample::*sample;
  Tensor Batch::*batch;
};

enum FieldIndex : size_t {
  kInput,
  kNormal,
  kDepth,
  kMask,
  kIllumination,
  kSss,
  kBsdf,
  kPolarised,
  kFieldCount
};

constexpr std::array<Field, kFieldCount> kFields = {
    {{"input", &Sample::input, &Batch::input},
     {"normal", &Sample::normal, &Batch::normal},
     {"depth", &Sample::depth, &Batch::depth},
     {"mask", &Sample::mask, &Batch::mask},
     {"illumination", &Sample::illumination, &Batch::illumination},
     {"SSS values", &Sample::sss, &Batch::sss},
     {"pure-BSDF images", &Sample::bsdf, &Batch::bsdf},
     {"polarised images", &Sample::polarised, &Batch::polarised}}};

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
  const Window window = scene.image_window();
  const bool inside =
      window.x0 >= 0 && window.y0 >= 0 && window.x1 <= scene.width && window.y1 <= scene.height;
  if (!inside || scene.image.size() != static_cast<size_t>(window.pixels()) * kStokesChannels ||
      scene.mask.size() != pixels || (!scene.bsdf.empty() && scene.bsdf.size() != pixels * kStokesChannels)) {
    fail(scene.source, "scene {} has {} image values for {}, {} pure-BSDF and {} mask values for {} pixels",
         scene.id, scene.image.size(), to_string(window), scene.bsdf.size(), scene.mask.size(), pixels);
  }
}

/// The shape of each field; empty where the scene lacks it or it is not wanted.
std::array<Shape, kFieldCount> shapes_of(const Scene& scene, const EncodeOptions& options,
                                         const EncodeWanted& wanted) {
  const auto image = [&](int64_t channels) { return Shape{scene.height, scene.width, channels}; };
  std::array<Shape, kFieldCount> shapes;
  const int64_t channels = input_channels(options);
  if (channels == 0) fail_usage("inputs", "the list of inputs is empty");
  shapes[kInput] = image(channels);
  shapes[kMask] = image(1);
  if (wanted.targets) {
    if (!scene.normal.empty()) shapes[kNormal] = image(3);
    if (!scene.depth.empty()) shapes[kDepth] = image(1);
    if (scene.sh && (scene.flash || !options.flash_in_illumination)) {
      shapes[kIllumination] = {illumination_values(options)};
    }
    if (scene.g && scene.sigma_t && scene.albedo && (scene.flash || !options.flash_in_sss)) {
      shapes[kSss] = {sss_values(options)};
    }
  }
  if (wanted.reconstruction) {
    shapes[kPolarised] = image(kPolariserChannels);
    if (!scene.bsdf.empty()) shapes[kBsdf] = image(kPolariserChannels);
  }
  return shapes;
}

/// Copies the object's values, zero elsewhere.
void copy_masked(const std::vector<float>& from, const Scene& scene, int64_t channels, float* to) {
  std::fill_n(to, scene.pixels() * channels, 0.0F);
  for (int64_t i = 0; i < scene.pixels(); ++i) {
    if (scene.mask[static_cast<size_t>(i)] == 0) continue;
    std::copy_n(from.data() + i * channels, channels, to + i * channels);
  }
}

/// Encodes a scene into the fields that are not null.
void fill(const Scene& scene, const EncodeOptions& options, const Shot& shot,
          const std::array<float*, kFieldCount>& to) {
  encode_images(scene, options, shot, {.input = to[kInput], .polarised = to[kPolarised], .bsdf = to[kBsdf]});
  std::transform(scene.mask.begin(), scene.mask.end(), to[kMask],
                 [](uint8_t object) { return object != 0 ? 1.0F : 0.0F; });
  if (to[kNormal] != nullptr) copy_masked(scene.normal, scene, 3, to[kNormal]);
  if (to[kDepth] != nullptr) copy_masked(scene.depth, scene, 1, to[kDepth]);
  if (float* out = to[kIllumination]; out != nullptr) {
    for (size_t i = 0; i < kShValues; ++i) *out++ = (*scene.sh)[i] * shot.gain[i / (kShValues / 3)];
    if (options.flash_in_illumination) *out = map_flash(*scene.flash * shot.flash_gain());
  }
  if (float* out = to[kSss]; out != nullptr) {
    *out++ = map_g(*scene.g);
    for (const float x : *scene.sigma_t) *out++ = map_sigma_t(x);
    for (const float x : *scene.albedo) *out++ = map_albedo(x);
    if (options.flash_in_sss) *out = map_flash(*scene.flash * shot.flash_gain());
  }
}

}  // namespace

bool needs_whole_image(const EncodeOptions& options, const EncodeWanted& wanted) {
  return wanted.reconstruction ||
         std::any_of(options.inputs.begin(), options.inputs.end(), [](InputKind kind) {
           return kind != InputKind::kPol4 && kind != InputKind::kMaxMin && kind != InputKind::kMask;
         });
}

Sample encode_scene(const Scene& scene, const EncodeOptions& options, const EncodeWanted& wanted,
                    const Shot& shot) {
  check_scene(scene);
  Sample sample;
  sample.id = scene.id;
  const std::array<Shape, kFieldCount> shapes = shapes_of(scene, options, wanted);
  std::array<float*, kFieldCount> to{};
  for (size_t i = 0; i < kFieldCount; ++i) {
    if (shapes[i].empty()) continue;
    Tensor& tensor = sample.*kFields[i].sample;
    tensor = Tensor(shapes[i]);
    to[i] = tensor.data<float>();
  }
  fill(scene, options, shot, to);
  return sample;
}

BatchBuilder::BatchBuilder(int64_t samples, const EncodeOptions& options, const EncodeWanted& wanted)
    : samples_(samples), options_(options), wanted_(wanted) {
  if (samples < 1) fail("make_batch", "no samples");
}

void BatchBuilder::add(const Scene& scene, const Shot& shot) {
  if (size() == samples_) fail("make_batch", "scene {} comes after all {} samples", scene.id, samples_);
  check_scene(scene);
  const std::array<Shape, kFieldCount> shapes = shapes_of(scene, options_, wanted_);
  std::array<float*, kFieldCount> to{};
  for (size_t i = 0; i < kFieldCount; ++i) {
    Tensor& tensor = batch_.*kFields[i].batch;
    if (batch_.ids.empty() && !shapes[i].empty()) {
      Shape shape = shapes[i];
      shape.insert(shape.begin(), samples_);
      tensor = Tensor(shape);
    }
    if (tensor.defined() != !shapes[i].empty()) {
      fail("make_batch", "of scenes {} and {} only one has {}", batch_.ids.front(), scene.id,
           kFields[i].name);
    }
    if (!tensor.defined()) continue;
    const Shape one(tensor.shape().begin() + 1, tensor.shape().end());
    if (one != shapes[i]) {
      fail("make_batch", "{} of scene {} is {}, of scene {} {}: scenes of a batch need one size",
           kFields[i].name, batch_.ids.front(), to_string(one), scene.id, to_string(shapes[i]));
    }
    to[i] = tensor.data<float>() + size() * numel(one);
  }
  fill(scene, options_, shot, to);
  batch_.ids.push_back(scene.id);
}

Batch BatchBuilder::take() {
  if (size() != samples_) fail("make_batch", "{} of {} samples were added", size(), samples_);
  return std::move(batch_);
}

Batch make_batch(std::span<const Sample> samples) {
  if (samples.empty()) fail("make_batch", "no samples");
  Batch batch;
  for (const Sample& sample : samples) batch.ids.push_back(sample.id);
  for (const Field& field : kFields) {
    const Tensor& first = samples.front().*field.sample;
    for (const Sample& sample : samples) {
      const Tensor& tensor = sample.*field.sample;
      if (tensor.defined() != first.defined()) {
        fail("make_batch", "of scenes {} and {} only one has {}", samples.front().id, sample.id, field.name);
      }
      if (tensor.defined() && tensor.shape() != first.shape()) {
        fail("make_batch", "{} of scene {} is {}, of scene {} {}: scenes of a batch need one size",
             field.name, samples.front().id, to_string(first.shape()), sample.id, to_string(tensor.shape()));
      }
    }
    if (!first.defined()) continue;
    Shape shape = first.shape();
    shape.insert(shape.begin(), static_cast<int64_t>(samples.size()));
    Tensor stacked(shape, first.dtype());
    std::byte* to = stacked.bytes();
    for (const Sample& sample : samples) {
      const Tensor& tensor = sample.*field.sample;
      std::memcpy(to, tensor.bytes(), static_cast<size_t>(tensor.byte_size()));
      to += tensor.byte_size();
    }
    batch.*field.batch = stacked;
  }
  return batch;
}

}  // namespace opaline
