// Writing a rendered scene.
#include <algorithm>
#include <array>
#include <cmath>
#include <span>

#include "core/error.h"
#include "core/file.h"
#include "data/scene_channels.h"
#include "data/scene_set.h"

namespace opaline {
namespace {

namespace fs = std::filesystem;

constexpr float kLargest = 6e4F;  // half floats end at 65504

/// Copies a window of `values` (interleaved, `channels` wide) out of a full image.
std::vector<float> cut(const std::vector<float>& values, int width, int channels, const Window& window) {
  std::vector<float> result;
  result.reserve(static_cast<size_t>(window.pixels() * channels));
  for (int y = window.y0; y < window.y1; ++y) {
    const auto row =
        values.begin() + (static_cast<std::ptrdiff_t>(y) * width + window.x0) * std::ptrdiff_t{channels};
    result.insert(result.end(), row, row + std::ptrdiff_t{window.width()} * channels);
  }
  return result;
}

int64_t clamp_to_half(std::vector<float>& values, const std::string& where) {
  int64_t clamped = 0;
  for (float& value : values) {
    if (!std::isfinite(value)) fail(where, "holds a value that is not finite ({})", value);
    if (std::abs(value) > kLargest) {
      value = std::copysign(kLargest, value);
      ++clamped;
    }
  }
  return clamped;
}

void check_size(const std::vector<float>& values, const SceneImages& images, int channels,
                std::string_view name, const std::string& where) {
  const int64_t needed = int64_t{images.width} * images.height * channels;
  if (static_cast<int64_t>(values.size()) != needed) {
    fail(where, "{} has {} values; {} x {} x {} needs {}", name, values.size(), images.height, images.width,
         channels, needed);
  }
}

/// Cuts the bytes of a scene's file into its sections.
std::array<FileSection, kSceneSections> sections_of(std::span<const std::byte> bytes, const ExrImage& exr,
                                                    const Window& box) {
  const std::vector<std::vector<ExrChunk>> parts = exr_chunks(bytes, exr);
  const std::vector<ExrChunk>& image = parts[0];
  const Window rows = grown(box, 1, exr.width, exr.height);
  // The last chunk that begins at or above the first row, the first that begins below the last one.
  int64_t box_begin = image.front().offset;
  int64_t box_end = parts[1].front().offset;
  for (const ExrChunk& chunk : image) {
    if (chunk.y <= rows.y0) box_begin = chunk.offset;
    if (chunk.y >= rows.y1) {
      box_end = chunk.offset;
      break;
    }
  }
  const std::array<int64_t, kSceneSections + 1> cuts = {0,
                                                        image.front().offset,
                                                        box_begin,
                                                        box_end,
                                                        parts[1].front().offset,
                                                        parts[2].front().offset,
                                                        static_cast<int64_t>(bytes.size())};
  std::array<FileSection, kSceneSections> sections;
  for (size_t i = 0; i < kSceneSections; ++i) {
    const int64_t size = cuts[i + 1] - cuts[i];
    sections[i] = {size,
                   to_hex(xxh64(bytes.subspan(static_cast<size_t>(cuts[i]), static_cast<size_t>(size))))};
  }
  return sections;
}

}  // namespace

Window coverage_box(const std::vector<float>& coverage, int width, int height) {
  Window box{width, height, 0, 0};
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const auto pixel = static_cast<size_t>(y) * static_cast<size_t>(width) + static_cast<size_t>(x);
      if (!(coverage[pixel] > 0.0F)) continue;
      box = {std::min(box.x0, x), std::min(box.y0, y), std::max(box.x1, x + 1), std::max(box.y1, y + 1)};
    }
  }
  return box.width() > 0 ? box : Window{0, 0, 1, 1};
}

WrittenScene write_scene(const fs::path& root, int64_t number, const SceneImages& images, SceneRecord& record,
                         const SceneStorage& storage) {
  const std::string where = fmt::format("write scene {}", record.id);
  check_size(images.image, images, kStokesChannels, "image", where);
  check_size(images.bsdf, images, kStokesChannels, "bsdf", where);
  check_size(images.normal, images, 3, "normal", where);
  check_size(images.depth, images, 1, "depth", where);
  check_size(images.coverage, images, 1, "coverage", where);

  record.box = coverage_box(images.coverage, images.width, images.height);
  double covered = 0;
  for (const float a : images.coverage) covered += static_cast<double>(a);
  record.coverage = covered / static_cast<double>(images.coverage.size());

  std::vector<float> truth;
  truth.reserve(images.coverage.size() * kTruthChannels);
  for (size_t i = 0; i < images.coverage.size(); ++i) {
    truth.insert(truth.end(), {images.normal[3 * i], images.normal[3 * i + 1], images.normal[3 * i + 2],
                               images.depth[i], images.coverage[i]});
  }
  const Window whole{0, 0, images.width, images.height};
  ExrImage exr{
      .width = images.width, .height = images.height, .compression = storage.compression, .parts = {}};
  exr.parts.push_back({.name = "image", .window = whole, .channels = kStokesNames, .pixels = images.image});
  exr.parts.push_back({.name = "bsdf",
                       .window = record.box,
                       .channels = kStokesNames,
                       .pixels = cut(images.bsdf, images.width, kStokesChannels, record.box)});
  exr.parts.push_back({.name = "truth",
                       .window = record.box,
                       .channels = kTruthNames,
                       .pixels = cut(truth, images.width, static_cast<int>(kTruthChannels), record.box)});
  WrittenScene written;
  for (ExrPart& part : exr.parts) {
    part.half = storage.half;
    written.clamped += clamp_to_half(part.pixels, where + ", " + part.name);
  }

  const std::vector<std::byte> bytes = encode_exr(exr);
  record.file = fmt::format("scenes/{:06}.exr", number);
  record.xxh64 = to_hex(xxh64(bytes));
  record.sections = sections_of(bytes, exr, record.box);
  fs::create_directories(root / "scenes");
  write_file_atomically(root / record.file, bytes);
  written.bytes = static_cast<int64_t>(bytes.size());
  return written;
}

bool scene_is_intact(const fs::path& root, const SceneRecord& record) {
  const fs::path path = root / record.file;
  return fs::is_regular_file(path) && to_hex(xxh64(read_file(path))) == record.xxh64;
}

}  // namespace opaline
