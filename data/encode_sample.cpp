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

/// Whether a field has as many pixels as the support, where there is one.
bool is_ragged(size_t field) {
  return field != kInput && field != kIllumination && field != kSss;
}

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
  const Window object = scene.object_window();
  const Window whole{0, 0, scene.width, scene.height};
  const auto fills = [](const std::vector<float>& values, const Window& part, size_t channels) {
    return values.size() == static_cast<size_t>(part.pixels()) * channels;
  };
  const auto absent_or_fills = [&](const std::vector<float>& values, size_t channels) {
    return values.empty() || fills(values, object, channels);
  };
  if (!whole.contains(window) || !whole.contains(object) || !fills(scene.image, window, kStokesChannels) ||
      scene.mask.size() != pixels || !absent_or_fills(scene.bsdf, kStokesChannels) ||
      !absent_or_fills(scene.normal, 3) || !absent_or_fills(scene.depth, 1)) {
    fail(scene.source,
         "scene {} has {} image values for {}; {} pure-BSDF, {} normal and {} depth values for {}; {} mask "
         "values for {} pixels",
         scene.id, scene.image.size(), to_string(window), scene.bsdf.size(), scene.normal.size(),
         scene.depth.size(), to_string(object), scene.mask.size(), pixels);
  }
}

/// The tiles of one scene, all of whose values were read.
std::shared_ptr<const ActiveSites> sites_of(const Scene& scene, int64_t dilation) {
  auto sites = support_of(1, scene.height, scene.width, scene.mask, dilation);
  const Window object = scene.object_window();
  for (const ActiveSites::Rectangle& tile : sites->rectangles()) {
    const Window window{static_cast<int>(tile.column), static_cast<int>(tile.row),
                        static_cast<int>(tile.column + tile.columns), static_cast<int>(tile.row + tile.rows)};
    if (!object.contains(window)) {
      fail(scene.source, "scene {}: {}, a part of its support, is outside what was read of it, {}", scene.id,
           to_string(window), to_string(object));
    }
  }
  return sites;
}

/// The shape of each field; empty where the scene lacks it or it is not wanted.
std::array<Shape, kFieldCount> shapes_of(const Scene& scene, const EncodeOptions& options,
                                         const EncodeWanted& wanted, const ActiveSites* sites) {
  const auto image = [&](int64_t channels) {
    return sites == nullptr ? Shape{scene.height, scene.width, channels} : Shape{sites->count(), channels};
  };
  std::array<Shape, kFieldCount> shapes;
  const int64_t channels = input_channels(options);
  if (channels == 0) fail_usage("inputs", "the list of inputs is empty");
  shapes[kInput] = {scene.height, scene.width, channels};
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

/// Copies the object's values, zero elsewhere. `values` are the scene's, of its object_window().
void copy_masked(const std::vector<float>& values, const Scene& scene, const ActiveSites* sites,
                 int64_t channels, float* to) {
  std::fill_n(to, (sites == nullptr ? scene.pixels() : sites->count()) * channels, 0.0F);
  const Window window = scene.object_window();
  for (int y = window.y0; y < window.y1; ++y) {
    for (int x = window.x0; x < window.x1; ++x) {
      const int64_t pixel = int64_t{y} * scene.width + x;
      if (scene.mask[static_cast<size_t>(pixel)] == 0) continue;
      const int64_t place = sites == nullptr ? pixel : sites->site(0, y, x);
      std::copy_n(values.data() + static_cast<int64_t>(window.at(x, y)) * channels, channels,
                  to + place * channels);
    }
  }
}

/// 1 on the object, 0 elsewhere.
void copy_mask(const Scene& scene, const ActiveSites* sites, float* to) {
  std::fill_n(to, sites == nullptr ? scene.pixels() : sites->count(), 0.0F);
  for (int64_t pixel = 0; pixel < scene.pixels(); ++pixel) {
    if (scene.mask[static_cast<size_t>(pixel)] == 0) continue;
    to[sites == nullptr ? pixel : sites->site(0, pixel / scene.width, pixel % scene.width)] = 1.0F;
  }
}

/// Encodes a scene into the fields that are not null.
void fill(const Scene& scene, const EncodeOptions& options, const Shot& shot, const ActiveSites* sites,
          const std::array<float*, kFieldCount>& to) {
  const Window whole{0, 0, scene.width, scene.height};
  if (sites == nullptr && scene.object_window() != whole) {
    fail(scene.source, "scene {}: {} is outside what was read of it, {}", scene.id, to_string(whole),
         to_string(scene.object_window()));
  }
  encode_images(scene, options, shot,
                {.input = to[kInput], .polarised = to[kPolarised], .bsdf = to[kBsdf], .sites = sites});
  copy_mask(scene, sites, to[kMask]);
  if (to[kNormal] != nullptr) copy_masked(scene.normal, scene, sites, 3, to[kNormal]);
  if (to[kDepth] != nullptr) copy_masked(scene.depth, scene, sites, 1, to[kDepth]);
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

/// Throws Error unless a scene of such fields fits the batch's first one.
void require_same(const std::string& first_id, const Shape& first, const std::string& id, const Shape& shape,
                  std::string_view name) {
  if (first.empty() != shape.empty()) {
    fail("make_batch", "of scenes {} and {} only one has {}", first_id, id, name);
  }
  if (first != shape) {
    fail("make_batch", "{} of scene {} is {}, of scene {} {}: scenes of a batch need one size", name,
         first_id, to_string(first), id, to_string(shape));
  }
}

Shape shape_or_none(const Tensor& tensor) {
  return tensor.defined() ? tensor.shape() : Shape{};
}

/// A field of all samples, one after the other, as one tensor of `shape`.
Tensor join(std::span<const Sample> samples, Tensor Sample::*field, const Shape& shape) {
  Tensor joined(shape, (samples.front().*field).dtype());
  std::byte* to = joined.bytes();
  for (const Sample& sample : samples) {
    const Tensor& tensor = sample.*field;
    std::memcpy(to, tensor.bytes(), static_cast<size_t>(tensor.byte_size()));
    to += tensor.byte_size();
  }
  return joined;
}

/// The shape of so many tensors of one shape, stacked.
Shape stacked(Shape shape, int64_t samples) {
  shape.insert(shape.begin(), samples);
  return shape;
}

}  // namespace

bool needs_whole_image(const EncodeOptions& options, const EncodeWanted& wanted) {
  return (wanted.reconstruction && !wanted.support) ||
         std::any_of(options.inputs.begin(), options.inputs.end(), [](InputKind kind) {
           return kind != InputKind::kPol4 && kind != InputKind::kMaxMin && kind != InputKind::kMask;
         });
}

Sample encode_scene(const Scene& scene, const EncodeOptions& options, const EncodeWanted& wanted,
                    const Shot& shot) {
  check_scene(scene);
  Sample sample;
  sample.id = scene.id;
  const std::array<Shape, kFieldCount> shapes = shapes_of(scene, options, wanted, nullptr);
  std::array<float*, kFieldCount> to{};
  for (size_t i = 0; i < kFieldCount; ++i) {
    if (shapes[i].empty()) continue;
    Tensor& tensor = sample.*kFields[i].sample;
    tensor = Tensor(shapes[i]);
    to[i] = tensor.data<float>();
  }
  fill(scene, options, shot, nullptr, to);
  return sample;
}

BatchBuilder::BatchBuilder(int64_t samples, const EncodeOptions& options, const EncodeWanted& wanted)
    : samples_(samples), options_(options), wanted_(wanted) {
  if (samples < 1) fail("make_batch", "no samples");
}

void BatchBuilder::add(const Scene& scene, const Shot& shot) {
  if (size() == samples_) fail("make_batch", "scene {} comes after all {} samples", scene.id, samples_);
  check_scene(scene);
  std::shared_ptr<const ActiveSites> sites;
  if (wanted_.support) sites = sites_of(scene, *wanted_.support);
  const std::array<Shape, kFieldCount> shapes = shapes_of(scene, options_, wanted_, sites.get());
  std::array<float*, kFieldCount> to{};
  Sample ragged;
  for (size_t i = 0; i < kFieldCount; ++i) {
    const Shape& shape = shapes[i];
    if (sites && is_ragged(i)) {
      to[i] = add_part(i, scene.id, shape, ragged);
    } else {
      to[i] = add_row(i, scene.id, shape);
    }
  }
  fill(scene, options_, shot, sites.get(), to);
  if (sites) {
    masks_.insert(masks_.end(), scene.mask.begin(), scene.mask.end());
    ragged_.push_back(std::move(ragged));
  }
  batch_.ids.push_back(scene.id);
}

/// Where a scene's values of a field go in the batch's tensor; null where there are none.
float* BatchBuilder::add_row(size_t field, const std::string& id, const Shape& shape) {
  Tensor& tensor = batch_.*kFields[field].batch;
  if (batch_.ids.empty()) {
    if (!shape.empty()) tensor = Tensor(stacked(shape, samples_));
  } else {
    const Shape first = tensor.defined() ? Shape(tensor.shape().begin() + 1, tensor.shape().end()) : Shape{};
    require_same(batch_.ids.front(), first, id, shape, kFields[field].name);
  }
  return tensor.defined() ? tensor.data<float>() + size() * numel(shape) : nullptr;
}

/// Where they go until all samples are there.
float* BatchBuilder::add_part(size_t field, const std::string& id, const Shape& shape, Sample& part) {
  if (!ragged_.empty()) {
    // There may be more or fewer sites than in the first; the input, which is whole, says whether sizes fit.
    Shape first = shape_or_none(ragged_.front().*kFields[field].sample);
    if (!first.empty() && !shape.empty()) first.front() = shape.front();
    require_same(batch_.ids.front(), first, id, shape, kFields[field].name);
  }
  if (shape.empty()) return nullptr;
  Tensor& tensor = part.*kFields[field].sample;
  tensor = Tensor(shape);
  return tensor.data<float>();
}

Batch BatchBuilder::take() {
  if (size() != samples_) fail("make_batch", "{} of {} samples were added", size(), samples_);
  if (!wanted_.support) return std::move(batch_);
  const Shape& image = batch_.input.shape();
  const auto sites = support_of(samples_, image[1], image[2], masks_, *wanted_.support);
  for (size_t i = 0; i < kFieldCount; ++i) {
    const Tensor& first = ragged_.front().*kFields[i].sample;
    if (!first.defined()) continue;
    Tensor& tensor = batch_.*kFields[i].batch;
    tensor = join(ragged_, kFields[i].sample, {sites->count(), first.size(1)});
    tensor.set_sites(sites);
    for (Sample& sample : ragged_) sample.*kFields[i].sample = {};
  }
  return std::move(batch_);
}

Batch make_batch(std::span<const Sample> samples) {
  if (samples.empty()) fail("make_batch", "no samples");
  Batch batch;
  for (const Sample& sample : samples) batch.ids.push_back(sample.id);
  for (const Field& field : kFields) {
    const Tensor& first = samples.front().*field.sample;
    for (const Sample& sample : samples) {
      require_same(samples.front().id, shape_or_none(first), sample.id, shape_or_none(sample.*field.sample),
                   field.name);
    }
    if (first.defined()) {
      batch.*field.batch =
          join(samples, field.sample, stacked(first.shape(), static_cast<int64_t>(samples.size())));
    }
  }
  return batch;
}

}  // namespace opaline
