#include "data/encode_images.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/error.h"
#include "data/gamma.h"

namespace opaline {
namespace {

constexpr int64_t kPolariserChannels = 12;

using Plane = std::array<float, kPixelBlock>;

/// The light of a block of pixels, clipped, and what follows from it; colour by colour.
struct LightBlock {
  PolariserBlock pol;
  std::array<Plane, kStokesChannels> stokes;  ///< of the clipped images
  std::array<Plane, 3> length;                ///< sqrt(S1^2 + S2^2)
};

enum class Region { kObject, kOutside, kEverywhere };

Region region_of(InputKind kind) {
  switch (kind) {
    case InputKind::kPol4:
    case InputKind::kMaxMin:
    case InputKind::kMask:
      return Region::kObject;
    case InputKind::kBackground:
      return Region::kOutside;
    case InputKind::kIntensity:
    case InputKind::kDopAop:
    case InputKind::kEncodedAop:
    case InputKind::kStokes:
      return Region::kEverywhere;
  }
  return Region::kEverywhere;
}

void add_stokes(size_t n, LightBlock& light) {
  for (size_t c = 0; c < 3; ++c) {
    const Plane &i0 = light.pol[c], &i45 = light.pol[3 + c], &i90 = light.pol[6 + c],
                &i135 = light.pol[9 + c];
    Plane &s0 = light.stokes[c], &s1 = light.stokes[3 + c], &s2 = light.stokes[6 + c];
    for (size_t k = 0; k < n; ++k) {
      s0[k] = (i0[k] + i45[k] + i90[k] + i135[k]) / 2.0F;
      s1[k] = i0[k] - i90[k];
      s2[k] = i45[k] - i135[k];
      light.length[c][k] = std::sqrt(s1[k] * s1[k] + s2[k] * s2[k]);
    }
  }
}

float aop(float s1, float s2) {
  constexpr float kPi = std::numbers::pi_v<float>;
  if (s1 == 0.0F && s2 == 0.0F) return 0.0F;
  const float angle = 0.5F * std::atan2(s2, s1);
  const float positive = angle < 0.0F ? angle + kPi : angle;
  return positive < kPi ? positive : 0.0F;  // a tiny negative angle plus pi rounds to pi
}

/// Where the pixels of a block are in an output.
using Places = std::array<int32_t, kPixelBlock>;

/// The values of one block of pixels, written into an image of `channels` from `to` on.
class BlockWriter {
 public:
  BlockWriter(const EncodeOptions& options, const LightBlock& light, size_t count)
      : options_(options), light_(light), count_(count) {}

  void write(InputKind kind, float* to, int64_t channels, const Places& places) {
    to_ = to;
    channels_ = channels;
    places_ = &places;
    switch (kind) {
      case InputKind::kIntensity:
        for (size_t c = 0; c < 3; ++c) {
          put_encoded([&](size_t k) { return light_.stokes[c][k] / 2.0F; });
        }
        return;
      case InputKind::kPol4:
        for (const Plane& plane : light_.pol) put_encoded(plane);
        return;
      case InputKind::kMaxMin:
        extreme(options_.min_first ? -1.0F : 1.0F);
        extreme(options_.min_first ? 1.0F : -1.0F);
        return;
      case InputKind::kDopAop:
        for (size_t c = 0; c < 3; ++c) {
          put([&](size_t k) {
            const float s0 = light_.stokes[c][k];
            return s0 > 0.0F ? light_.length[c][k] / s0 : 0.0F;
          });
        }
        for (size_t c = 0; c < 3; ++c) {
          put([&](size_t k) { return aop(light_.stokes[3 + c][k], light_.stokes[6 + c][k]); });
        }
        return;
      case InputKind::kEncodedAop:
        for (size_t c = 0; c < 3; ++c) {
          put([&](size_t k) { return over_length(3 + c, k, 1.0F); });
        }
        for (size_t c = 0; c < 3; ++c) {
          put([&](size_t k) { return over_length(6 + c, k, 0.0F); });
        }
        return;
      case InputKind::kStokes:
        for (const Plane& plane : light_.stokes) {
          put([&](size_t k) { return plane[k]; });
        }
        return;
      case InputKind::kMask:
        put([](size_t) { return 1.0F; });
        return;
      case InputKind::kBackground:
        for (size_t c = 0; c < 3; ++c) put_encoded(light_.pol[c]);
        return;
    }
  }

 private:
  template <class F>
  void put(const F& value) {
    for (size_t k = 0; k < count_; ++k) to_[(*places_)[k] * channels_] = value(k);
    ++to_;
  }
  void put_encoded(const Plane& linear) {
    const std::span<const float> values(linear.data(), count_);
    if (options_.quantise) {
      encode_network_8bit(values, encoded_.data());
    } else {
      encode_network(values, encoded_.data());
    }
    put([&](size_t k) { return encoded_[k]; });
  }
  template <class F>
  void put_encoded(const F& linear) {
    for (size_t k = 0; k < count_; ++k) linear_[k] = linear(k);
    put_encoded(linear_);
  }
  void extreme(float sign) {
    for (size_t c = 0; c < 3; ++c) {
      put_encoded([&](size_t k) { return (light_.stokes[c][k] + sign * light_.length[c][k]) / 2.0F; });
    }
  }
  float over_length(size_t stokes, size_t k, float otherwise) const {
    const float norm = light_.length[stokes % 3][k];
    return norm > 0.0F ? light_.stokes[stokes][k] / norm : otherwise;
  }

  const EncodeOptions& options_;
  const LightBlock& light_;
  size_t count_;
  float* to_ = nullptr;
  int64_t channels_ = 0;
  const Places* places_ = nullptr;
  Plane linear_{}, encoded_{};
};

std::vector<PixelIndex> pixels_of(const Scene& scene, Region region, const Window& window) {
  std::vector<PixelIndex> pixels;
  pixels.reserve(static_cast<size_t>(window.pixels()));
  int32_t inside = 0;
  for (int y = window.y0; y < window.y1; ++y) {
    for (int x = window.x0; x < window.x1; ++x, ++inside) {
      const int32_t at = y * scene.width + x;
      const bool object = scene.mask[static_cast<size_t>(at)] != 0;
      if (region == Region::kEverywhere || object == (region == Region::kObject)) {
        pixels.push_back({.image = at, .window = inside});
      }
    }
  }
  return pixels;
}

/// The pixels that exist, and where they are in a window.
std::vector<PixelIndex> pixels_of(const ActiveSites& sites, const Window& window) {
  std::vector<PixelIndex> pixels;
  pixels.reserve(static_cast<size_t>(sites.count()));
  for (const ActiveSites::Rectangle& rectangle : sites.rectangles()) {
    for (int64_t y = rectangle.row; y < rectangle.row + rectangle.rows; ++y) {
      for (int64_t x = rectangle.column; x < rectangle.column + rectangle.columns; ++x) {
        pixels.push_back(
            {.image = static_cast<int32_t>(y * sites.w() + x),
             .window = static_cast<int32_t>(window.at(static_cast<int>(x), static_cast<int>(y)))});
      }
    }
  }
  return pixels;
}

/// Places in a whole image, or among the sites of one.
Places places_of(std::span<const PixelIndex> pixels, const ActiveSites* sites) {
  Places places{};
  for (size_t k = 0; k < pixels.size(); ++k) {
    const int32_t at = pixels[k].image;
    places[k] =
        sites == nullptr ? at : static_cast<int32_t>(sites->site(0, at / sites->w(), at % sites->w()));
  }
  return places;
}

/// Calls f(pixels of a block) over all of them.
template <class F>
void for_each_block(const std::vector<PixelIndex>& pixels, const F& f) {
  for (size_t begin = 0; begin < pixels.size(); begin += kPixelBlock) {
    f(std::span(pixels).subspan(begin, std::min(kPixelBlock, pixels.size() - begin)));
  }
}

/// A kind and the channel where it begins.
struct Placed {
  InputKind kind;
  int64_t channel;
};

void encode_region(const Scene& scene, const EncodeOptions& options, const Shot& shot, Region region,
                   const ImageOutputs& outputs) {
  const int64_t channels = input_channels(options);
  std::vector<Placed> kinds;
  int64_t channel = 0;
  for (const InputKind kind : options.inputs) {
    if (region_of(kind) == region) kinds.push_back({kind, channel});
    channel += channels_of(kind);
  }
  const bool target = outputs.polarised != nullptr && region == Region::kObject;
  if (kinds.empty() && !target) return;
  const Window window = scene.image_window();
  const std::vector<PixelIndex> pixels = pixels_of(scene, region, window);
  if (region == Region::kObject) {
    const auto object =
        scene.mask.size() - static_cast<size_t>(std::count(scene.mask.begin(), scene.mask.end(), 0));
    if (object != pixels.size()) {
      fail(scene.source, "scene {}: {} of {} pixels of the object are outside the light that was read, {}",
           scene.id, object - pixels.size(), object, to_string(window));
    }
  } else if (window != Window{0, 0, scene.width, scene.height}) {
    fail(scene.source, "scene {}: input '{}' needs the whole image, but {} was read", scene.id,
         to_string(kinds.front().kind), to_string(window));
  }
  const StokesView view{scene.image.data(), window, scene.width, scene.height};
  LightBlock light;
  for_each_block(pixels, [&](std::span<const PixelIndex> block) {
    photograph(view, shot, Layer::kImage, block, light.pol);
    add_stokes(block.size(), light);
    BlockWriter writer(options, light, block.size());
    const Places places = places_of(block, nullptr);
    for (const Placed& placed : kinds) {
      writer.write(placed.kind, outputs.input + placed.channel, channels, places);
    }
    if (target) {
      writer.write(InputKind::kPol4, outputs.polarised, kPolariserChannels, places_of(block, outputs.sites));
    }
  });
}

}  // namespace

void encode_images(const Scene& scene, const EncodeOptions& options, const Shot& shot,
                   const ImageOutputs& outputs) {
  const int64_t sites = outputs.sites == nullptr ? scene.pixels() : outputs.sites->count();
  // What no light reaches is black.
  std::fill_n(outputs.input, scene.pixels() * input_channels(options), -1.0F);
  if (outputs.polarised != nullptr) {
    std::fill_n(outputs.polarised, sites * kPolariserChannels, -1.0F);
  }
  for (const Region region : {Region::kObject, Region::kOutside, Region::kEverywhere}) {
    encode_region(scene, options, shot, region, outputs);
  }
  if (outputs.bsdf == nullptr) return;
  const Window window = scene.object_window();
  const StokesView view{scene.bsdf.data(), window, scene.width, scene.height};
  const std::vector<PixelIndex> pixels = outputs.sites == nullptr
                                             ? pixels_of(scene, Region::kEverywhere, window)
                                             : pixels_of(*outputs.sites, window);
  LightBlock light;
  for_each_block(pixels, [&](std::span<const PixelIndex> block) {
    photograph(view, shot, Layer::kBsdf, block, light.pol);
    BlockWriter(options, light, block.size())
        .write(InputKind::kPol4, outputs.bsdf, kPolariserChannels, places_of(block, outputs.sites));
  });
}

}  // namespace opaline
