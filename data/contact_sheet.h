// Scenes of a data set side by side, as its files hold them, in one picture.
#pragma once

#include <string>
#include <vector>

#include "data/dataset.h"
#include "data/picture.h"

namespace opaline {

/// One view of a scene.
struct SceneTile {
  std::string name;
  Picture picture;
};

/// What there is of image, bsdf, DoP, AoP, normal and depth. Light is gamma-encoded.
std::vector<SceneTile> scene_tiles(const Scene& scene);

/// A scene of either split.
struct ScenePlace {
  Split split = Split::kTrain;
  int64_t index = 0;
};

/// At most `count` scenes, evenly spaced over training and then test scenes, the first and the last included.
std::vector<ScenePlace> spread_scenes(const Dataset& dataset, int64_t count);

struct ContactSheetOptions {
  int64_t scenes = 24;
  int tile = 96;  ///< pixels of a tile's side at most
};

/// A row of tiles a scene, two scenes beside each other, each under its split, id, sigma_t per metre, albedo
/// and g. A scene that cannot be read leaves its place empty and says so.
Picture contact_sheet(const Dataset& dataset, const ContactSheetOptions& options = {});

/// Draws text (letters, digits, point and minus; other characters are blank) into a picture, (x, y) its top
/// left corner; letters are 6 x 10 pixels, 8 apart.
void draw_text(Picture& picture, int x, int y, std::string_view text);

}  // namespace opaline
