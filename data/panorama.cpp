#include "data/panorama.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "core/error.h"
#include "core/file.h"
#include "data/exr.h"
#include "data/hdr.h"

namespace opaline {
namespace {

using render::Rgb;

std::string lower_extension(const std::filesystem::path& path) {
  std::string end = path.extension().string();
  std::transform(end.begin(), end.end(), end.begin(),
                 [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c; });
  return end;
}

struct Picture {
  int64_t width = 0, height = 0;
  std::vector<float> pixels;  // H x W x 3
};

Picture read_exr_picture(const std::filesystem::path& path) {
  static const std::array<std::string, 3> kChannels = {"R", "G", "B"};
  const std::vector<std::byte> bytes = read_file(path, int64_t{1} << 32);
  const ExrReader reader(bytes, path.string());
  const auto& parts = reader.parts();
  const auto has_colours = [](const ExrPartInfo& part) {
    return std::all_of(kChannels.begin(), kChannels.end(), [&](const std::string& name) {
      return std::find(part.channels.begin(), part.channels.end(), name) != part.channels.end();
    });
  };
  const auto found = std::find_if(parts.begin(), parts.end(), has_colours);
  if (found == parts.end()) fail(path.string(), "has no part with channels R, G and B");
  ExrPart part = reader.read(found->name, kChannels);
  return {part.window.width(), part.window.height(), std::move(part.pixels)};
}

/// A row of the result as source rows with their shares; the same of columns.
struct Share {
  int64_t index;
  double weight;
};

/// Cuts [begin, end) of `count` cells by `measure`, the integral of the weight from the start to x.
template <class F>
std::vector<Share> shares(double begin, double end, int64_t count, const F& measure) {
  std::vector<Share> result;
  for (auto i = static_cast<int64_t>(begin); i < count && static_cast<double>(i) < end; ++i) {
    const double from = std::max(begin, static_cast<double>(i));
    const double to = std::min(end, static_cast<double>(i + 1));
    if (to > from) result.push_back({i, (measure(to) - measure(from)) / (measure(end) - measure(begin))});
  }
  return result;
}

}  // namespace

bool is_panorama_file(const std::filesystem::path& path) {
  const std::string end = lower_extension(path);
  return end == ".exr" || end == ".hdr";
}

std::vector<Rgb> shrink_panorama(const std::vector<Rgb>& texels, int64_t width, int64_t height) {
  const auto rows = static_cast<int64_t>(texels.size()) / width, columns = 2 * height;
  const double tall = static_cast<double>(rows) / static_cast<double>(height);
  const double wide = static_cast<double>(width) / static_cast<double>(columns);
  // Solid angle above a row, and the share of a row left of a column.
  const auto band = [rows](double row) {
    return 1.0 - std::cos(std::numbers::pi * row / static_cast<double>(rows));
  };
  const auto even = [](double column) { return column; };
  std::vector<std::vector<Share>> across;
  for (int64_t j = 0; j < columns; ++j) {
    across.push_back(shares(static_cast<double>(j) * wide, static_cast<double>(j + 1) * wide, width, even));
  }
  std::vector<Rgb> result(static_cast<size_t>(height * columns));
  for (int64_t i = 0; i < height; ++i) {
    for (const Share& row :
         shares(static_cast<double>(i) * tall, static_cast<double>(i + 1) * tall, rows, band)) {
      const Rgb* from = texels.data() + row.index * width;
      for (int64_t j = 0; j < columns; ++j) {
        Rgb& texel = result[static_cast<size_t>(i * columns + j)];
        for (const Share& column : across[static_cast<size_t>(j)]) {
          for (size_t c = 0; c < 3; ++c) texel[c] += row.weight * column.weight * from[column.index][c];
        }
      }
    }
  }
  return result;
}

render::Environment read_panorama(const std::filesystem::path& path, int64_t height) {
  const std::string file = path.string();
  Picture picture;
  if (lower_extension(path) == ".hdr") {
    HdrImage image = read_hdr(path);
    picture = {image.width, image.height, std::move(image.pixels)};
  } else {
    picture = read_exr_picture(path);
  }
  if (picture.width != 2 * picture.height) {
    fail(file, "has {} x {} pixels; a panorama is twice as wide as high", picture.width, picture.height);
  }
  std::vector<Rgb> texels(static_cast<size_t>(picture.width * picture.height));
  double sum = 0.0;
  for (size_t i = 0; i < texels.size(); ++i) {
    for (size_t c = 0; c < 3; ++c) {
      const double value = picture.pixels[3 * i + c];
      if (!(value >= 0.0 && std::isfinite(value))) {
        fail(file, "holds a radiance of {} in row {}, column {}", value,
             static_cast<int64_t>(i) / picture.width, static_cast<int64_t>(i) % picture.width);
      }
      texels[i][c] = value;
      sum += value;
    }
  }
  if (!(sum > 0.0)) fail(file, "is black");
  if (picture.height > height) {
    texels = shrink_panorama(texels, picture.width, height);
    picture.width = 2 * height;
  }
  return {std::move(texels), picture.width};
}

}  // namespace opaline
