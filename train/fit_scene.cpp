#include "train/fit_scene.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "core/parallel.h"

namespace opaline {
namespace {

constexpr int kDivisor = 16;
constexpr int kSmallest = 32;

int padded(int size) {
  return std::max(kSmallest, (size + kDivisor - 1) / kDivisor * kDivisor);
}

/// What output pixel i of `to` takes of the input pixels of a row of `from`: a box of from / to pixels.
struct Box {
  int begin = 0;
  std::vector<double> weights;  // sum to 1
};

std::vector<Box> boxes(int from, int to) {
  std::vector<Box> result(static_cast<size_t>(to));
  const double step = static_cast<double>(from) / to;
  for (int i = 0; i < to; ++i) {
    const double low = i * step;
    const double high = (i + 1) * step;
    Box& box = result[static_cast<size_t>(i)];
    box.begin = static_cast<int>(low);
    for (int p = box.begin; p < std::min(from, static_cast<int>(std::ceil(high))); ++p) {
      const double overlap = std::min(high, p + 1.0) - std::max(low, static_cast<double>(p));
      box.weights.push_back(std::max(0.0, overlap) / step);
    }
  }
  return result;
}

/// One image, H x W x channels, into the middle of a canvas.
struct Resampler {
  int from_width, from_height;
  std::vector<Box> columns, rows;
  int width, height;  // of the canvas
  int left, top;      // of the content in it

  Resampler(const Scene& scene, int content_width, int content_height)
      : from_width(scene.width),
        from_height(scene.height),
        columns(boxes(scene.width, content_width)),
        rows(boxes(scene.height, content_height)),
        width(padded(content_width)),
        height(padded(content_height)),
        left((width - content_width) / 2),
        top((height - content_height) / 2) {}

  template <class T>
  std::vector<double> operator()(const std::vector<T>& image, int channels) const {
    std::vector<double> canvas(static_cast<size_t>(width) * static_cast<size_t>(height) *
                               static_cast<size_t>(channels));
    parallel_for(static_cast<int64_t>(rows.size()), [&](int64_t y) {
      const Box& row = rows[static_cast<size_t>(y)];
      for (size_t x = 0; x < columns.size(); ++x) {
        const Box& column = columns[x];
        const size_t to =
            (static_cast<size_t>(top + y) * static_cast<size_t>(width) + static_cast<size_t>(left) + x) *
            static_cast<size_t>(channels);
        for (size_t i = 0; i < row.weights.size(); ++i) {
          for (size_t j = 0; j < column.weights.size(); ++j) {
            const size_t pixel = (static_cast<size_t>(row.begin) + i) * static_cast<size_t>(from_width) +
                                 static_cast<size_t>(column.begin) + j;
            const double weight = row.weights[i] * column.weights[j];
            for (size_t c = 0; c < static_cast<size_t>(channels); ++c) {
              canvas[to + c] +=
                  weight * static_cast<double>(image[pixel * static_cast<size_t>(channels) + c]);
            }
          }
        }
      }
    });
    return canvas;
  }
};

}  // namespace

Scene fit_scene(const Scene& scene, int64_t size) {
  const int longer = std::max(scene.width, scene.height);
  const double scale = size > 0 && longer > size ? static_cast<double>(size) / longer : 1.0;
  const auto scaled = [&](int side) { return std::max(1, static_cast<int>(std::lround(side * scale))); };
  const Resampler resample(scene, scaled(scene.width), scaled(scene.height));
  if (resample.width == scene.width && resample.height == scene.height && scale == 1.0) return scene;

  Scene result = scene;
  result.width = resample.width;
  result.height = resample.height;
  result.bsdf.clear();
  result.normal.clear();
  result.depth.clear();
  const std::vector<double> image = resample(scene.image, kStokesChannels);
  result.image.resize(image.size());
  std::transform(image.begin(), image.end(), result.image.begin(),
                 [](double v) { return static_cast<float>(v); });
  const std::vector<double> mask = resample(scene.mask, 1);
  result.mask.resize(mask.size());
  std::transform(mask.begin(), mask.end(), result.mask.begin(),
                 [](double v) { return static_cast<uint8_t>(v >= 0.5 ? 1 : 0); });
  return result;
}

}  // namespace opaline
