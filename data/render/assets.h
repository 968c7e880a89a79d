// Objects, bump maps and panoramas from outside, as scenes draw them.
#pragma once

#include <cstddef>
#include <functional>
#include <optional>
#include <string>
#include <vector>

#include "data/render/light.h"
#include "data/render/relief.h"
#include "data/render/surface.h"

namespace opaline::render {

/// Things by name. `load` may be called from several threads; nullopt where a thing cannot be used, which
/// whoever loads has to report.
template <class T>
struct Collection {
  std::vector<std::string> names{};
  std::function<std::optional<T>(size_t index)> load{};
};

/// What the scenes of one split may use. Empty collections leave everything to chance: bodies, noise, rooms.
struct Assets {
  Collection<Surface> objects{};  ///< closed, facing outwards, of any size
  Collection<HeightMap> bumps{};
  Collection<Environment> panoramas{};
};

}  // namespace opaline::render
