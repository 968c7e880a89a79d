// Scenes for training tests, by simple physics: one sphere under a headlight, whose light leaves the surface
// after diffuse scattering and is polarised by the refraction there.
#pragma once

#include <unistd.h>

#include <cmath>
#include <filesystem>
#include <string>

#include "core/error.h"
#include "core/random.h"
#include "data/dataset.h"

namespace opaline::test {

struct SyntheticOptions {
  int64_t train = 8;
  int64_t test = 4;
  int size = 32;
  std::string fingerprint = "synthetic-1";
  int64_t poisoned = -1;   ///< training scene whose normals hold a NaN, as no reader would give
  int64_t empty = -1;      ///< training scene without an object
  int64_t one_pixel = -1;  ///< training scene whose object is one pixel
  int64_t damaged = -1;    ///< scene of both splits that cannot be read
};

class SyntheticDataset : public Dataset {
 public:
  explicit SyntheticDataset(const SyntheticOptions& options) : options_(options) {
    facts_.layout = "synthetic";
    facts_.root = "synthetic";
    facts_.width = facts_.height = options.size;
    facts_.fingerprint = options.fingerprint;
  }

  const DatasetFacts& facts() const override { return facts_; }
  int64_t size(Split split) const override { return split == Split::kTrain ? options_.train : options_.test; }
  std::string id(Split split, int64_t index) const override {
    return (split == Split::kTrain ? "train-" : "test-") + std::to_string(index);
  }

  Scene load(Split split, int64_t index, const LoadOptions& wanted) const override {
    if (index == options_.damaged) throw Error("the file ends early");
    Random random(7, Purpose::kTest, split == Split::kTrain ? 0 : 1, static_cast<uint32_t>(index));
    Scene scene;
    scene.id = id(split, index);
    scene.source = "synthetic";
    scene.width = scene.height = options_.size;
    const auto pixels = static_cast<size_t>(scene.pixels());
    scene.image.resize(kStokesChannels * pixels);
    scene.mask.resize(pixels);
    scene.normal.resize(3 * pixels);
    scene.depth.resize(pixels);

    const double radius = random.uniform(0.5, 0.8);
    const double cx = random.uniform(-0.15, 0.15);
    const double cy = random.uniform(-0.15, 0.15);
    scene.g = random.uniform_float() * 0.9F;
    scene.flash = 35.0F + 40.0F * random.uniform_float();
    scene.sigma_t.emplace();
    scene.albedo.emplace();
    scene.sh.emplace();
    for (float& value : *scene.sigma_t) value = 32.0F * random.uniform_float();
    for (float& value : *scene.albedo) value = 0.3F + 0.65F * random.uniform_float();
    for (float& value : *scene.sh) value = 0.3F * random.uniform_float();

    for (size_t i = 0; i < pixels; ++i) {
      const double x =
          (static_cast<double>(i % static_cast<size_t>(options_.size)) + 0.5) / options_.size * 2 - 1 - cx;
      const double y =
          1 - (static_cast<double>(i / static_cast<size_t>(options_.size)) + 0.5) / options_.size * 2 - cy;
      const double r2 = (x * x + y * y) / (radius * radius);
      if (r2 >= 1.0) continue;
      if (split == Split::kTrain && index == options_.empty) continue;
      const size_t middle = pixels / 2 + static_cast<size_t>(options_.size) / 2;
      if (split == Split::kTrain && index == options_.one_pixel && i != middle) continue;
      const double nx = x / radius;
      const double ny = y / radius;
      const double nz = std::sqrt(1.0 - r2);
      scene.mask[i] = 1;
      scene.normal[3 * i] = static_cast<float>(nx);
      scene.normal[3 * i + 1] = static_cast<float>(ny);
      scene.normal[3 * i + 2] = static_cast<float>(nz);
      scene.depth[i] = static_cast<float>(radius * nz);
      // Degree of polarisation rises towards the silhouette; its plane is that of the normal.
      const double dop = 0.4 * r2;
      const double azimuth = std::atan2(ny, nx);
      for (size_t c = 0; c < 3; ++c) {
        const double light = *scene.flash / 75.0 * (*scene.albedo)[c] * (0.3 + 0.7 * nz) *
                             (1.0 + (*scene.sigma_t)[c] / 32.0) / 2.0;
        const double s0 = 2.0 * light * 0.9;
        float* const stokes = scene.image.data() + kStokesChannels * i;
        stokes[c] = static_cast<float>(s0);
        stokes[3 + c] = static_cast<float>(s0 * dop * std::cos(2.0 * azimuth));
        stokes[6 + c] = static_cast<float>(s0 * dop * std::sin(2.0 * azimuth));
      }
    }
    if (wanted.bsdf) {
      scene.bsdf = scene.image;
      for (float& value : scene.bsdf) value *= 0.5F;
    }
    if (split == Split::kTrain && index == options_.poisoned)
      scene.normal[3 * (pixels / 2 + static_cast<size_t>(options_.size) / 2)] = std::nanf("");
    return scene;
  }

 private:
  SyntheticOptions options_;
  DatasetFacts facts_;
};

/// A folder that dies with the test.
class TemporaryFolder {
 public:
  explicit TemporaryFolder(const std::string& name)
      : path_(std::filesystem::temp_directory_path() /
              ("opaline-" + name + "-" + std::to_string(::getpid()))) {
    std::filesystem::remove_all(path_);
    std::filesystem::create_directories(path_);
  }
  ~TemporaryFolder() {
    std::error_code error;
    std::filesystem::remove_all(path_, error);
  }
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

}  // namespace opaline::test
