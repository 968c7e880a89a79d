// What the tests of data/ share: folders that vanish, small scenes, errors by message, mutated files.
#pragma once

#include <unistd.h>

#include <catch2/catch.hpp>
#include <cmath>
#include <cstdint>
#include <cstring>
#include <filesystem>
#include <functional>
#include <limits>
#include <span>
#include <string>
#include <vector>

#include "core/error.h"
#include "core/file.h"
#include "core/random.h"
#include "data/scene.h"
#include "data/scene_set.h"

namespace opaline::test {

/// A fresh folder, removed at the end of its scope.
class TempFolder {
 public:
  TempFolder() {
    std::string name = (std::filesystem::temp_directory_path() / "opaline_data_XXXXXX").string();
    if (::mkdtemp(name.data()) == nullptr) throw Error("cannot make a temporary folder");
    path_ = name;
  }
  TempFolder(const TempFolder&) = delete;
  TempFolder& operator=(const TempFolder&) = delete;
  ~TempFolder() {
    std::error_code ignored;
    std::filesystem::remove_all(path_, ignored);
  }
  const std::filesystem::path& path() const { return path_; }
  std::filesystem::path operator/(const std::string& name) const { return path_ / name; }

 private:
  std::filesystem::path path_;
};

/// The message of the Error that f throws; fails the test where it throws none.
inline std::string message_of(const std::function<void()>& f) {
  try {
    f();
  } catch (const Error& e) {
    return e.what();
  }
  FAIL("no error was thrown");
  return {};
}

inline bool contains(const std::string& text, const std::string& part) {
  return text.find(part) != std::string::npos;
}

/// Parses `trials` damaged versions of a valid file: bytes changed, spans cut out, doubled or moved, the end
/// cut off. Each must be parsed or refused with an Error; anything else escapes and fails the test.
/// Returns how many were refused.
inline int parse_mutations(const std::vector<std::byte>& valid, int trials, uint64_t seed,
                           const std::function<void(std::span<const std::byte>)>& parse) {
  int refused = 0;
  for (int trial = 0; trial < trials; ++trial) {
    Random random(seed, Purpose::kTest, 0, static_cast<uint32_t>(trial));
    std::vector<std::byte> bytes = valid;
    const auto position = [&] { return random.below(static_cast<uint32_t>(bytes.size())); };
    const uint32_t changes = 1 + random.below(4);
    for (uint32_t change = 0; change < changes && !bytes.empty(); ++change) {
      const auto at = static_cast<std::ptrdiff_t>(position());
      const auto length = std::min<std::ptrdiff_t>(static_cast<std::ptrdiff_t>(random.below(64)),
                                                   static_cast<std::ptrdiff_t>(bytes.size()) - at);
      switch (random.below(5)) {
        case 0:
          bytes[static_cast<size_t>(at)] = static_cast<std::byte>(random.below(256));
          break;
        case 1:
          bytes[static_cast<size_t>(at)] ^= static_cast<std::byte>(1U << random.below(8));
          break;
        case 2:
          bytes.erase(bytes.begin() + at, bytes.begin() + at + length);
          break;
        case 3: {
          const std::vector<std::byte> copy(bytes.begin() + at, bytes.begin() + at + length);
          bytes.insert(bytes.begin() + static_cast<std::ptrdiff_t>(position()), copy.begin(), copy.end());
          break;
        }
        default:
          bytes.resize(static_cast<size_t>(at));
      }
    }
    try {
      parse(bytes);
    } catch (const Error&) {
      ++refused;
    }
  }
  return refused;
}

/// A disc of unit-sphere normals in the middle, light that differs from pixel to pixel, an inner border of
/// partly covered pixels. `variant` changes the light.
inline SceneImages small_images(int width, int height, uint32_t variant = 0, float radius = 0.7F) {
  SceneImages images{.width = width, .height = height};
  Random random(11, Purpose::kTest, 1, variant);
  const auto pixels = static_cast<size_t>(width) * static_cast<size_t>(height);
  images.normal.assign(3 * pixels, 0.0F);
  images.depth.assign(pixels, 0.0F);
  images.coverage.assign(pixels, 0.0F);
  for (int y = 0; y < height; ++y) {
    for (int x = 0; x < width; ++x) {
      const size_t i = static_cast<size_t>(y) * static_cast<size_t>(width) + static_cast<size_t>(x);
      const float u = (2.0F * (static_cast<float>(x) + 0.5F) / static_cast<float>(width) - 1.0F) / radius;
      const float v = (1.0F - 2.0F * (static_cast<float>(y) + 0.5F) / static_cast<float>(height)) / radius;
      const float r2 = u * u + v * v;
      if (r2 < 1.0F) {
        const float z = std::sqrt(1.0F - r2);
        images.coverage[i] = r2 < 0.9F ? 1.0F : 0.5F;
        images.normal[3 * i] = u;
        images.normal[3 * i + 1] = v;
        images.normal[3 * i + 2] = z;
        images.depth[i] = z;
      }
      for (int kind = 0; kind < 2; ++kind) {
        std::vector<float>& out = kind == 0 ? images.image : images.bsdf;
        const bool same = kind == 1 && r2 >= 1.0F;
        for (int c = 0; c < 9; ++c) {
          const float value = c < 3 ? 0.2F + 1.2F * random.uniform_float() : 0.1F * random.uniform_float();
          out.push_back(same ? images.image[9 * i + static_cast<size_t>(c)] : value);
        }
      }
    }
  }
  return images;
}

inline SceneRecord small_record(const std::string& id, uint32_t variant = 0) {
  Random random(12, Purpose::kTest, 2, variant);
  SceneRecord record;
  record.id = id;
  for (double& x : record.sigma_t) x = random.uniform(0, 32);
  for (double& x : record.albedo) x = random.uniform(0.3, 0.95);
  record.g = random.uniform(0, 0.9);
  record.flash = random.uniform(35, 75);
  for (double& x : record.sh) x = random.normal();
  record.object = fmt::format("sphere-{}", id);
  record.environment = fmt::format("sky-{}", id);
  record.seed = (uint64_t{1} << 63) + variant;
  record.spp = 16;
  record.seconds = 0.25;
  return record;
}

/// Writes a whole data set of ours with scenes of size x size pixels.
inline void write_small_set(const std::filesystem::path& root, int train, int test, int size = 32,
                            float radius = 0.7F) {
  std::vector<SceneRecord> records;
  for (int i = 0; i < train + test; ++i) {
    SceneRecord record = small_record(std::to_string(i), static_cast<uint32_t>(i));
    write_scene(root, i, small_images(size, size, static_cast<uint32_t>(i), radius), record);
    records.push_back(record);
  }
  write_scene_index(root / "train.jsonl", {records.begin(), records.begin() + train});
  write_scene_index(root / "test.jsonl", {records.begin() + train, records.end()});
  write_scene_set_info(
      root,
      {.generator_version = "0.1.0", .seed = 7, .train = train, .test = test, .width = size, .height = size});
}

}  // namespace opaline::test
