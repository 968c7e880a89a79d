#include "data/picture.h"

#include <algorithm>
#include <cmath>
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
