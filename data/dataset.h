// A set of scenes behind one interface, whatever its layout.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <string_view>

#include "data/scene.h"
#include "data/stored_light.h"

namespace opaline {

enum class Split { kTrain, kTest };

std::string_view to_string(Split split);

/// What to decode; what is not asked for is not paid for.
struct LoadOptions {
  bool bsdf = true;   ///< pure-BSDF images (reconstruction alone needs them)
  bool truth = true;  ///< normal and depth (the mask always comes)
  /// The light of every pixel; else a reader may leave out what is outside the object's box grown by a pixel
  /// (Scene::window says what it did). With `bsdf` the whole comes, or what `support` says.
  bool whole = true;
  /// A reader may leave out `bsdf`, `normal` and `depth` outside the box of the tiles that touch the mask and
  /// of so many tiles around them (support_of), grown by a pixel (Scene::object says what it did).
  std::optional<int64_t> support = {};
};

struct DatasetFacts {
  std::string layout;  ///< "opaline", "released synthetic" or "capture"
  std::filesystem::path root;
  int width = 0;  ///< of its images; 0 where they differ
  int height = 0;
  /// Changes where the set's index does: what a resumed run compares.
  std::string fingerprint;
};

class Dataset {
 public:
  virtual ~Dataset() = default;
  virtual const DatasetFacts& facts() const = 0;
  virtual int64_t size(Split split) const = 0;
  virtual std::string id(Split split, int64_t index) const = 0;
  /// Reads one scene; safe from several threads. Damage is an error that names file and scene. Negative,
  /// infinite and NaN light never comes through: it is an error as well.
  virtual Scene load(Split split, int64_t index, const LoadOptions& options = {}) const = 0;
  /// The scene's light as it is stored, for checks; nothing where the layout has Stokes images alone (ours).
  virtual std::optional<StoredLight> load_stored(Split, int64_t) const { return std::nullopt; }
};

/// Opens a folder, detecting its layout: ours (dataset.toml), the released synthetic set (train.csv or
/// test.csv), the released captures (folders with p0.png, or one such folder; all in Split::kTest).
/// Throws Error naming what was looked for.
std::unique_ptr<Dataset> open_dataset(const std::filesystem::path& root);

}  // namespace opaline
