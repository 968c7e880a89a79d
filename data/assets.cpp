#include "data/assets.h"

#include <fmt/format.h>

#include <algorithm>
#include <mutex>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "core/error.h"
#include "core/file.h"
#include "data/mesh_file.h"
#include "data/mesh_repair.h"
#include "data/panorama.h"
#include "data/png.h"

namespace opaline {
namespace {

namespace fs = std::filesystem;

constexpr int kMostMapTexels = 256;

struct Asset {
  std::string name;
  fs::path path;
};
using Splits = std::array<std::vector<Asset>, 2>;

bool is_bump_file(const fs::path& path) {
  return path.extension() == ".png" || path.extension() == ".PNG";
}

uint64_t hash_of(std::string_view text) {
  return xxh64(std::as_bytes(std::span(text.data(), text.size())));
}

std::string name_of(const fs::path& path, const fs::path& root) {
  std::string name = path.lexically_relative(root).replace_extension().generic_string();
  constexpr std::string_view kShapeNet = "/models/model_normalized";
  if (name.ends_with(kShapeNet)) name.resize(name.size() - kShapeNet.size());
  return name;
}

/// Sorted by name, so that nothing depends on the order of the file system.
template <class F>
std::vector<Asset> find_assets(const fs::path& root, const F& wanted) {
  std::vector<Asset> found;
  for (const auto& entry : fs::recursive_directory_iterator(root)) {
    if (entry.is_regular_file() && wanted(entry.path()))
      found.push_back({name_of(entry.path(), root), entry.path()});
  }
  std::sort(found.begin(), found.end(), [](const Asset& a, const Asset& b) {
    return std::tie(a.name, a.path) < std::tie(b.name, b.path);
  });
  return found;
}

template <class F>
Splits split_assets(const fs::path& root, const F& wanted, double test_share, uint64_t seed) {
  if (fs::is_directory(root / "train") && fs::is_directory(root / "test")) {
    return {find_assets(root / "train", wanted), find_assets(root / "test", wanted)};
  }
  Splits splits;
  for (Asset& asset : find_assets(root, wanted)) {
    const uint64_t hash = hash_of(fmt::format("{}/{}", seed, asset.name));
    const bool test = static_cast<double>(hash >> 11) * 0x1p-53 < test_share;
    splits[test ? 1 : 0].push_back(std::move(asset));
  }
  return splits;
}

}  // namespace

struct AssetFolders::Log {
  std::mutex mutex;
  std::map<std::string, std::string> skipped;

  bool has(const std::string& file) {
    const std::lock_guard lock(mutex);
    return skipped.contains(file);
  }
  void add(const std::string& file, const std::string& reason) {
    const std::lock_guard lock(mutex);
    skipped[file] = reason;
  }
};

AssetFolders::AssetFolders(const AssetConfig& config, uint64_t seed, bool train, bool test)
    : log_(std::make_shared<Log>()) {
  const auto add = [&]<class T, class Wanted, class Load>(
                       std::string_view key, const std::string& folder, const Wanted& wanted,
                       render::Collection<T> render::Assets::*member, const Load& load) {
    if (folder.empty()) return;
    if (!fs::is_directory(folder)) fail_usage("render", "render.{}: there is no folder {}", key, folder);
    Splits splits = split_assets(folder, wanted, config.test_share, seed);
    std::string names;
    for (size_t s = 0; s < 2; ++s) {
      const std::vector<Asset>& assets = splits[s];
      if (assets.empty() && (s == 0 ? train : test)) {
        fail_usage("render",
                   "render.{}: {} holds no file for {} scenes ({} for the others); change render.test_share, "
                   "or add files",
                   key, folder, s == 0 ? "training" : "test", splits[1 - s].size());
      }
      render::Collection<T>& collection = splits_[s].*member;
      for (const Asset& asset : assets) {
        collection.names.push_back(asset.name);
        names += asset.name + '\n';
      }
      names += '\n';
    }
    text_ += fmt::format("{}_found = \"{} + {}, {}\"\n", key, splits[0].size(), splits[1].size(),
                         to_hex(hash_of(names)));
    for (size_t s = 0; s < 2; ++s) {
      (splits_[s].*member).load = [assets = std::move(splits[s]), load,
                                   log = log_](size_t i) -> std::optional<T> {
        const std::string file = assets[i].path.string();
        if (log->has(file)) return std::nullopt;
        try {
          return load(assets[i]);
        } catch (const Error& error) {
          log->add(file, error.what());
          return std::nullopt;
        }
      };
    }
  };
  add("objects", config.objects, is_mesh_file, &render::Assets::objects, [](const Asset& asset) {
    render::Surface surface = read_mesh(asset.path);
    repair_mesh(surface, asset.path.string());
    return surface;
  });
  add("bumps", config.bumps, is_bump_file, &render::Assets::bumps,
      [](const Asset& asset) { return read_height_map(asset.path); });
  add("panoramas", config.panoramas, is_panorama_file, &render::Assets::panoramas,
      [height = config.panorama_height](const Asset& asset) { return read_panorama(asset.path, height); });
}

std::map<std::string, std::string> AssetFolders::skipped() const {
  const std::lock_guard lock(log_->mutex);
  return log_->skipped;
}

render::HeightMap read_height_map(const fs::path& path) {
  const PngImage image = read_png(path);
  const int step = (std::max(image.width, image.height) + kMostMapTexels - 1) / kMostMapTexels;
  render::HeightMap map{
      .name = path.stem().string(), .width = image.width / step, .height = image.height / step, .values = {}};
  if (map.width < 2 || map.height < 2) {
    fail(path.string(), "has {} x {} pixels, too few for bumps", image.width, image.height);
  }
  map.values.reserve(static_cast<size_t>(map.width) * static_cast<size_t>(map.height));
  for (int j = 0; j < map.height; ++j) {
    for (int i = 0; i < map.width; ++i) {
      double sum = 0.0;
      for (int y = j * step; y < (j + 1) * step; ++y) {
        for (int x = i * step; x < (i + 1) * step; ++x) {
          const uint16_t grey = image.samples[image.at(x, y, 0)];
          for (int c = 1; c < image.channels; ++c) {
            if (image.samples[image.at(x, y, c)] != grey) {
              fail(path.string(), "is coloured at row {}, column {}; a height map is grey", y, x);
            }
          }
          sum += grey;
        }
      }
      map.values.push_back(static_cast<float>(sum / (step * step)));
    }
  }
  return map;
}

}  // namespace opaline
