#include "data/picture.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <string_view>

#include "data/encode.h"
#include "data/png.h"

namespace opaline {
namespace {

// Anchors of the heat map, evenly spaced: light rises from one to the next, so that it also reads in grey.
constexpr std::array<std::array<double, 3>, 6> kHeat = {
    {{8, 6, 40}, {74, 16, 107}, {150, 38, 103}, {221, 81, 58}, {252, 165, 10}, {252, 250, 164}}};

template <class Colour>
Picture paint(const MaskedMap& map, std::array<uint8_t, 3> outside, const Colour& colour) {
  Picture picture{.width = map.width, .height = map.height, .rgb = {}};
  picture.rgb.resize(3 * map.mask.size());
  for (size_t i = 0; i < map.mask.size(); ++i) {
    const std::array<uint8_t, 3> rgb = map.mask[i] != 0 ? colour(i) : outside;
    std::copy(rgb.begin(), rgb.end(), picture.rgb.begin() + static_cast<std::ptrdiff_t>(3 * i));
  }
  return picture;
}

/// S0, S1, S2 of a pixel, summed over the colours.
std::array<float, 3> stokes_at(const Scene& scene, size_t pixel) {
  const float* const s = scene.image.data() + kStokesChannels * pixel;
  return {s[0] + s[1] + s[2], s[3] + s[4] + s[5], s[6] + s[7] + s[8]};
}

float dop_of(const std::array<float, 3>& s) {
  return s[0] > 0.0F ? std::hypot(s[1], s[2]) / s[0] : 0.0F;
}

/// The pure colour at a share of the circle from red over green and blue.
std::array<float, 3> hue_colour(float share) {
  std::array<float, 3> rgb{};
  for (size_t c = 0; c < 3; ++c) {
    const float distance = std::abs(std::remainder(6.0F * share - 2.0F * static_cast<float>(c), 6.0F));
    rgb[c] = std::clamp(2.0F - distance, 0.0F, 1.0F);
  }
  return rgb;
}

MaskedMap object_of(const Scene& scene) {
  return {.values = {}, .mask = scene.mask, .width = scene.width, .height = scene.height};
}

/// Mean of a block of whole pixels, those that the picture has.
std::array<uint8_t, 3> block_mean(const Picture& picture, int x0, int y0, int block) {
  std::array<int, 3> sum{};
  int count = 0;
  for (int y = y0; y < std::min(y0 + block, picture.height); ++y) {
    for (int x = x0; x < std::min(x0 + block, picture.width); ++x) {
      const auto at =
          3 * (static_cast<size_t>(y) * static_cast<size_t>(picture.width) + static_cast<size_t>(x));
      for (size_t c = 0; c < 3; ++c) sum[c] += picture.rgb[at + c];
      ++count;
    }
  }
  std::array<uint8_t, 3> mean{};
  for (size_t c = 0; c < 3; ++c) mean[c] = static_cast<uint8_t>((sum[c] + count / 2) / std::max(1, count));
  return mean;
}

}  // namespace

Picture picture_of_input(const Scene& scene) {
  Picture picture{.width = scene.width, .height = scene.height, .rgb = {}};
  const auto pixels = static_cast<size_t>(scene.pixels());
  picture.rgb.resize(3 * pixels);
  for (size_t i = 0; i < pixels; ++i) {
    for (size_t c = 0; c < 3; ++c) {
      picture.rgb[3 * i + c] = to_byte(encode_gamma(scene.image[kStokesChannels * i + c] / 2.0F));
    }
  }
  return picture;
}

Picture picture_of_normals(const MaskedMap& normals) {
  return paint(normals, {0, 0, 0}, [&](size_t i) {
    const float* const n = normals.values.data() + 3 * i;
    const float length = std::max(1e-12F, std::sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]));
    std::array<uint8_t, 3> rgb{};
    for (size_t c = 0; c < 3; ++c) rgb[c] = to_byte((n[c] / length + 1.0F) / 2.0F);
    return rgb;
  });
}

Picture picture_of_depth(const MaskedMap& depth, float low, float high) {
  // The farthest point is dark grey, so that it does not vanish in the black around the object.
  constexpr float kDarkest = 0.15F;
  return paint(depth, {0, 0, 0}, [&](size_t i) {
    const float share = high > low ? std::clamp((depth.values[i] - low) / (high - low), 0.0F, 1.0F) : 1.0F;
    const uint8_t grey = to_byte(kDarkest + (1.0F - kDarkest) * share);
    return std::array<uint8_t, 3>{grey, grey, grey};
  });
}

Picture picture_of_dop(const Scene& scene, float high) {
  return paint(object_of(scene), {0, 0, 0}, [&](size_t i) {
    return heat_colour(static_cast<double>(dop_of(stokes_at(scene, i))) / static_cast<double>(high));
  });
}

Picture picture_of_aop(const Scene& scene) {
  // From this degree of polarisation on, the hue is at its brightest: scattered light seldom has more.
  constexpr float kBright = 0.1F;
  return paint(object_of(scene), {0, 0, 0}, [&](size_t i) {
    const std::array<float, 3> s = stokes_at(scene, i);
    const float value = std::sqrt(std::min(1.0F, dop_of(s) / kBright));
    const std::array<float, 3> hue = hue_colour(std::atan2(s[2], s[1]) / (2.0F * std::numbers::pi_v<float>));
    std::array<uint8_t, 3> rgb{};
    for (size_t c = 0; c < 3; ++c) rgb[c] = to_byte(value * hue[c]);
    return rgb;
  });
}

Picture scaled_to(const Picture& picture, int side) {
  const int longest = std::max({picture.width, picture.height, 1});
  const int block = std::max(1, (longest + side - 1) / side);
  const int copies = std::max(1, side / longest);
  Picture result{.width = (picture.width + block - 1) / block * copies,
                 .height = (picture.height + block - 1) / block * copies,
                 .rgb = {}};
  for (int y = 0; y < result.height; ++y) {
    for (int x = 0; x < result.width; ++x) {
      const std::array<uint8_t, 3> rgb = block_mean(picture, x / copies * block, y / copies * block, block);
      result.rgb.insert(result.rgb.end(), rgb.begin(), rgb.end());
    }
  }
  return result;
}

std::array<uint8_t, 3> heat_colour(double share) {
  const double at = std::clamp(share, 0.0, 1.0) * static_cast<double>(kHeat.size() - 1);
  const size_t left = std::min(static_cast<size_t>(at), kHeat.size() - 2);
  const double part = at - static_cast<double>(left);
  std::array<uint8_t, 3> rgb{};
  for (size_t c = 0; c < 3; ++c) {
    rgb[c] = static_cast<uint8_t>(std::lround(kHeat[left][c] + part * (kHeat[left + 1][c] - kHeat[left][c])));
  }
  return rgb;
}

Picture picture_of_error(const MaskedMap& error, float high) {
  return paint(error, {255, 255, 255}, [&](size_t i) {
    return heat_colour(static_cast<double>(error.values[i]) / static_cast<double>(high));
  });
}

ValueRange range_inside(const MaskedMap& map) {
  bool any = false;
  ValueRange range;
  for (size_t i = 0; i < map.mask.size(); ++i) {
    if (map.mask[i] == 0) continue;
    const float value = map.values[i];
    range.low = any ? std::min(range.low, value) : value;
    range.high = any ? std::max(range.high, value) : value;
    any = true;
  }
  return range;
}

void write_picture(const std::filesystem::path& path, const Picture& picture) {
  write_png(path, picture.width, picture.height, 3, picture.rgb);
}

std::string data_uri(const Picture& picture) {
  return "data:image/png;base64," + base64(encode_png(picture.width, picture.height, 3, picture.rgb));
}

std::string base64(std::span<const std::byte> bytes) {
  constexpr std::string_view kAlphabet = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  std::string text;
  text.reserve((bytes.size() + 2) / 3 * 4);
  for (size_t i = 0; i < bytes.size(); i += 3) {
    const size_t n = std::min<size_t>(3, bytes.size() - i);
    uint32_t word = 0;
    for (size_t k = 0; k < 3; ++k) word = word << 8 | (k < n ? std::to_integer<uint32_t>(bytes[i + k]) : 0U);
    for (size_t k = 0; k < 4; ++k) {
      text += k <= n ? kAlphabet[word >> (18 - 6 * k) & 63U] : '=';
    }
  }
  return text;
}

}  // namespace opaline
