#include "data/dataset.h"

#include "core/error.h"
#include "data/capture.h"
#include "data/released.h"
#include "data/scene_set.h"

namespace opaline {

int64_t Scene::byte_size() const {
  const size_t floats = image.size() + bsdf.size() + normal.size() + depth.size();
  return static_cast<int64_t>(floats * sizeof(float) + mask.size());
}

std::string_view to_string(Split split) {
  return split == Split::kTrain ? "train" : "test";
}

std::unique_ptr<Dataset> open_dataset(const std::filesystem::path& root) {
  namespace fs = std::filesystem;
  if (!fs::is_directory(root)) fail(root.string(), "is not a folder");
  if (fs::exists(root / "dataset.toml")) return open_scene_set(root);
  if (fs::exists(root / "train.csv") || fs::exists(root / "test.csv")) return open_released_set(root);
  if (has_captures(root)) return open_captures(root);
  fail(root.string(),
       "holds no data set: looked for dataset.toml (ours), train.csv or test.csv (the released synthetic "
       "set), "
       "p0.png here or one folder down (captures)");
}

}  // namespace opaline
