// bench_convert: a data set of ours stored anew, or its training scenes in the layout of the released
// synthetic set, for comparisons with loaders of that layout.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <array>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <string>
#include <vector>

#include "core/error.h"
#include "core/file.h"
#include "data/encode.h"
#include "data/gamma.h"
#include "data/npy.h"
#include "data/png.h"
#include "data/scene_channels.h"
#include "data/scene_set.h"

namespace opaline::bench {
namespace {

namespace fs = std::filesystem;

/// A file's images at full size, as they were rendered.
SceneImages read_images(const fs::path& path) {
  const std::vector<std::byte> bytes = read_file(path);
  const ExrReader reader(bytes, path.string());
  SceneImages images{.width = reader.width(), .height = reader.height()};
  images.image = reader.read("image", kStokesNames).pixels;
  images.bsdf = images.image;
  const auto pixels = static_cast<size_t>(images.width) * static_cast<size_t>(images.height);
  images.normal.assign(3 * pixels, 0.0F);
  images.depth.assign(pixels, 0.0F);
  images.coverage.assign(pixels, 0.0F);
  const ExrPart bsdf = reader.read("bsdf", kStokesNames);
  const ExrPart truth = reader.read("truth", kTruthNames);
  const Window& box = truth.window;
  for (int y = box.y0; y < box.y1; ++y) {
    for (int x = box.x0; x < box.x1; ++x) {
      const auto to = static_cast<size_t>(y * images.width + x);
      const auto from = static_cast<size_t>((y - box.y0) * box.width() + x - box.x0);
      std::copy_n(bsdf.pixels.data() + 9 * from, 9, images.bsdf.data() + 9 * to);
      const float* values = truth.pixels.data() + kTruthChannels * from;
      std::copy_n(values, 3, images.normal.data() + 3 * to);
      images.depth[to] = values[3];
      images.coverage[to] = values[4];
    }
  }
  return images;
}

void store_anew(const fs::path& from, const fs::path& to) {
  for (const std::string split : {"train", "test"}) {
    std::vector<SceneRecord> records = read_scene_index(from / (split + ".jsonl"));
    for (SceneRecord& record : records) {
      const int64_t number = std::stoll(fs::path(record.file).stem().string());
      write_scene(to, number, read_images(from / record.file), record);
    }
    write_scene_index(to / (split + ".jsonl"), records);
  }
  write_scene_set_info(to, read_scene_set_info(from));
}

void write_levels(const fs::path& path, int width, int height, const std::vector<float>& linear) {
  std::vector<float> levels(linear.size());
  encode_8bit(linear, levels.data());
  std::vector<uint8_t> bytes(levels.size());
  std::transform(levels.begin(), levels.end(), bytes.begin(),
                 [](float x) { return static_cast<uint8_t>(x); });
  write_png(path, width, height, 3, bytes);
}

/// Linear colour images out of a Stokes image: value(s) of the nine values s of a pixel and a colour.
template <class F>
std::vector<float> derive(const std::vector<float>& stokes, const F& value) {
  std::vector<float> image(stokes.size() / 3);
  for (size_t i = 0; i < image.size(); ++i) image[i] = value(stokes.data() + i / 3 * 9 + i % 3);
  return image;
}

void write_light(const fs::path& folder, const SceneImages& images, const std::vector<float>& stokes,
                 const std::string& suffix) {
  const auto write = [&](const std::string& name, const auto& value) {
    write_levels(folder / (name + suffix + ".png"), images.width, images.height, derive(stokes, value));
  };
  write("0", [](const float* s) { return (s[0] + s[3]) / 2.0F; });
  write("45", [](const float* s) { return (s[0] + s[6]) / 2.0F; });
  write("90", [](const float* s) { return (s[0] - s[3]) / 2.0F; });
  write("135", [](const float* s) { return (s[0] - s[6]) / 2.0F; });
  if (!suffix.empty()) return;
  write("max", [](const float* s) { return (s[0] + std::hypot(s[3], s[6])) / 2.0F; });
  write("min", [](const float* s) { return (s[0] - std::hypot(s[3], s[6])) / 2.0F; });
}

void write_released(const fs::path& from, const fs::path& to) {
  std::string csv;
  for (const SceneRecord& record : read_scene_index(from / "train.jsonl")) {
    const int64_t number = std::stoll(fs::path(record.file).stem().string());
    const fs::path folder = to / "train" / std::to_string(number);
    fs::create_directories(folder);
    const SceneImages images = read_images(from / record.file);
    write_light(folder, images, images.image, "");
    write_light(folder, images, images.bsdf, "_BSDF");
    std::vector<uint8_t> mask, normals;
    for (size_t i = 0; i < images.coverage.size(); ++i) {
      mask.push_back(images.coverage[i] == 1.0F ? 255 : 0);
      for (size_t c = 0; c < 3; ++c) normals.push_back(to_byte((images.normal[3 * i + c] + 1.0F) / 2.0F));
    }
    write_png(folder / "mask.png", images.width, images.height, 1, mask);
    write_png(folder / "normal.png", images.width, images.height, 3, normals);
    write_npy(folder / "depth.npy", images.depth, std::vector<int64_t>{images.height, images.width});
    std::vector<float> coefficients(27);
    for (size_t i = 0; i < 27; ++i) coefficients[i] = static_cast<float>(record.sh[i % 3 * 9 + i / 3]);
    write_npy(folder / "coeffs.npy", coefficients, std::vector<int64_t>{9, 3});
    csv += fmt::format("{};obj;env;bump;{};{},{},{};{},{},{};{};1;0;0;0;0;0;0;0;0;0;1\n", number,
                       record.flash, record.sigma_t[0] / 32, record.sigma_t[1] / 32, record.sigma_t[2] / 32,
                       record.albedo[0], record.albedo[1], record.albedo[2], record.g);
  }
  write_file_atomically(to / "train.csv", csv);
}

}  // namespace
}  // namespace opaline::bench

int main(int argc, char** argv) {
  CLI::App app{
      "Stores a data set of ours anew, or its training scenes in the layout of the released synthetic set"};
  std::string from, to, layout = "opaline";
  app.add_option("from", from, "Data set of ours")->required();
  app.add_option("to", to, "Folder to write")->required();
  app.add_option("--layout", layout, "opaline or released")
      ->check(CLI::IsMember({"opaline", "released"}))
      ->capture_default_str();
  CLI11_PARSE(app, argc, argv);
  try {
    if (layout == "released") {
      opaline::bench::write_released(from, to);
    } else {
      opaline::bench::store_anew(from, to);
    }
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_convert: %s\n", error.what());
    return 1;
  }
  return 0;
}
