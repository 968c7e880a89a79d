// Our data set on disk:
//   dataset.toml             conventions, counts, seed, generator
//   train.jsonl, test.jsonl  one object a line, one line a scene
//   scenes/NNNNNN.exr        parts image, bsdf, truth (half floats; the last two have the mask's box as
//   window)
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "data/dataset.h"
#include "data/exr.h"

namespace opaline {

/// What a scene's file consists of, in its order: headers and line tables; the lines of part image that are
/// above the box grown by a pixel, that meet it and that are below; part bsdf; part truth.
enum class SceneSection : size_t { kHead, kAbove, kBox, kBelow, kBsdf, kTruth };
inline constexpr size_t kSceneSections = 6;

struct FileSection {
  int64_t bytes = 0;
  std::string xxh64;  ///< of these bytes, 16 hexadecimal digits
  bool operator==(const FileSection&) const = default;
};

/// A line of train.jsonl or test.jsonl.
struct SceneRecord {
  std::string id;
  std::string file;                 ///< relative to the data set, as "scenes/000017.exr"
  std::string xxh64;                ///< of the file's bytes, 16 hexadecimal digits
  Window box;                       ///< of mask.A > 0
  double coverage = 0;              ///< mean of mask.A over the image
  std::array<double, 3> sigma_t{};  ///< per metre
  std::array<double, 3> albedo{};
  double g = 0;
  double flash = 0;             ///< radiance
  std::array<double, 27> sh{};  ///< three colours x nine
  std::string object;
  std::string environment;
  uint64_t seed = 0;
  int64_t spp = 0;  ///< camera paths into the medium, a pixel of the object, mean
  double seconds = 0;
  /// Lets a reader fetch and check a part of the file; without them the whole file is read.
  std::optional<std::array<FileSection, kSceneSections>> sections;
};

/// One line of JSON, without a line end.
std::string to_json_line(const SceneRecord& record);
/// The reverse. `where` names file and line in messages; missing keys, wrong types and values out of range
/// are errors, unknown keys are not.
SceneRecord parse_scene_record(std::string_view line, std::string_view where);

/// All records of a .jsonl file; empty lines are skipped. Lines that do not parse, and a last one without
/// line end, as an interrupted writer leaves it, are errors, or are dropped where `salvage` says so.
std::vector<SceneRecord> read_scene_index(const std::filesystem::path& path, bool salvage = false);
/// The whole file at once, atomically.
void write_scene_index(const std::filesystem::path& path, const std::vector<SceneRecord>& records);
/// Adds a line in one write and syncs it; a failure leaves the file as it was.
void append_scene_record(const std::filesystem::path& path, const SceneRecord& record);

/// What `dataset.toml` holds besides the conventions, which are fixed for what we write.
struct SceneSetInfo {
  std::string generator = "opaline";
  std::string generator_version = {};
  uint64_t seed = 0;
  int64_t train = 0;  ///< scenes
  int64_t test = 0;
  int width = 0;
  int height = 0;
  std::string bsdf = "clear";    ///< reading of "pure BSDF": clear or reflection
  std::string config_text = {};  ///< the resolved render config, kept word for word; may be empty
};

void write_scene_set_info(const std::filesystem::path& root, const SceneSetInfo& info);
/// Throws Error where a convention is one that we cannot convert.
SceneSetInfo read_scene_set_info(const std::filesystem::path& root);

/// The images of one rendered scene, full size, channels last.
struct SceneImages {
  int width = 0;
  int height = 0;
  std::vector<float> image = {};     ///< H x W x 9 linear Stokes
  std::vector<float> bsdf = {};      ///< H x W x 9
  std::vector<float> normal = {};    ///< H x W x 3
  std::vector<float> depth = {};     ///< H x W
  std::vector<float> coverage = {};  ///< H x W, in [0, 1]: mask.A
};

struct WrittenScene {
  int64_t bytes = 0;
  int64_t clamped = 0;  ///< values over 6e4 in size, clamped to it
};

/// Box of coverage > 0; 1 x 1 at the origin where there is none.
Window coverage_box(const std::vector<float>& coverage, int width, int height);

/// How scenes are stored; the defaults were chosen by measurement (docs/benchmarks.md).
struct SceneStorage {
  ExrCompression compression = ExrCompression::kRle;
  bool half = true;  ///< half floats, else floats
};

/// Writes scenes/<NNNNNN>.exr under `root` (the folder is made) and fills the record's file, xxh64, sections,
/// box and coverage. NaN and infinity are errors that name the scene.
WrittenScene write_scene(const std::filesystem::path& root, int64_t number, const SceneImages& images,
                         SceneRecord& record, const SceneStorage& storage = {});

/// True where the record's file is there and has its checksum (a resumed writer skips such scenes).
bool scene_is_intact(const std::filesystem::path& root, const SceneRecord& record);

/// Opens a data set of ours.
std::unique_ptr<Dataset> open_scene_set(const std::filesystem::path& root);

}  // namespace opaline
