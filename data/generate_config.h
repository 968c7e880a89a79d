// What a data set is rendered from: the table [render] of a config.
#pragma once

#include <cstdint>
#include <string>

#include "data/assets.h"
#include "data/render/render.h"
#include "data/toml_config.h"

namespace opaline {

/// The table [render] of a config.
struct GenerateConfig {
  int64_t train = 0;  ///< scenes
  int64_t test = 0;
  uint64_t seed = 1;
  render::Camera camera{};
  render::SceneRanges ranges{};
  AssetConfig assets{};
  int64_t spp = 32;    ///< samples a pixel; with `error` the least of the pure-BSDF image's
  double error = 0.0;  ///< over 0: samples follow these errors (data/render/render.h)
  double dop_error = 0.0;
  render::BsdfReading bsdf = render::BsdfReading::kClear;
  int64_t photons = 0;  ///< light sub-paths of a scene's guide; 0: as many as it can use

  /// Every key above that decides what a scene looks like, as TOML lines: what a resumed run is compared
  /// with.
  std::string text() const;
};

/// Reads the table; problems are recorded in the config that it belongs to.
GenerateConfig read_generate_config(const TomlTable& table);

}  // namespace opaline
