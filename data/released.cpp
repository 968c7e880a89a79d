#include "data/released.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>
#include <set>

#include "core/error.h"
#include "core/file.h"
#include "data/capture.h"
#include "data/npy.h"
#include "data/png.h"

namespace opaline {
namespace {

namespace fs = std::filesystem;

constexpr float kSigmaTScale = 32.0F;
constexpr std::array<std::string_view, 19> kColumns = {"scene",           "obj",
                                                       "envmap",          "normal",
                                                       "radiance",        "sigma_t",
                                                       "albedo",          "g",
                                                       "obj_scale",       "obj_rotate_x",
                                                       "obj_rotate_y",    "obj_rotate_z",
                                                       "obj_translate_x", "obj_translate_y",
                                                       "obj_translate_z", "env_rotate_x",
                                                       "env_rotate_y",    "env_rotate_z",
                                                       "uv_scale"};
constexpr size_t kRadiance = 4;
constexpr size_t kSigmaT = 5;
constexpr size_t kAlbedo = 6;
constexpr size_t kG = 7;

std::vector<std::string_view> split_at(std::string_view text, char separator) {
  std::vector<std::string_view> parts;
  while (true) {
    const size_t at = text.find(separator);
    parts.push_back(text.substr(0, at));
    if (at == std::string_view::npos) return parts;
    text.remove_prefix(at + 1);
  }
}

std::string_view trimmed(std::string_view text) {
  constexpr std::string_view kSpace = " \t\r\"[]()";
  const size_t begin = text.find_first_not_of(kSpace);
  if (begin == std::string_view::npos) return {};
  return text.substr(begin, text.find_last_not_of(kSpace) - begin + 1);
}

struct Range {
  float min;
  float max;
};

float parse_number(std::string_view text, std::string_view where, std::string_view column,
                   const Range& range) {
  const std::string_view digits = trimmed(text);
  float value = 0;
  const auto [end, error] = std::from_chars(digits.data(), digits.data() + digits.size(), value);
  if (error != std::errc() || end != digits.data() + digits.size()) {
    fail(where, "column '{}' holds '{}', which is not a number with a decimal point", column, digits);
  }
  if (!(value >= range.min && value <= range.max)) {
    fail(where, "column '{}' is {}; it must be from {} to {}", column, value, range.min, range.max);
  }
  return value;
}

std::array<float, 3> parse_triple(std::string_view text, std::string_view where, std::string_view column,
                                  const Range& range) {
  const std::vector<std::string_view> parts = split_at(text, ',');
  if (parts.size() != 3) {
    fail(where, "column '{}' holds '{}'; three numbers joined by commas are expected", column, trimmed(text));
  }
  std::array<float, 3> values{};
  for (size_t i = 0; i < 3; ++i) values[i] = parse_number(parts[i], where, column, range);
  return values;
}

std::vector<ReleasedRecord> read_csv(const fs::path& path) {
  const std::string text = read_text(path);
  std::vector<ReleasedRecord> records;
  std::set<std::string> ids;
  size_t number = 0;
  for (const std::string_view line : split_at(text, '\n')) {
    ++number;
    if (trimmed(line).empty()) continue;
    const std::string where = fmt::format("{}:{}", path.string(), number);
    records.push_back(parse_released_record(line, where));
    if (!ids.insert(records.back().id).second) fail(where, "scene {} is listed twice", records.back().id);
  }
  return records;
}

void check_image_size(int width, int height, const Scene& scene, const fs::path& path) {
  if (width != scene.width || height != scene.height) {
    fail(path.string(), "has {} x {} pixels, the images {} x {}", width, height, scene.width, scene.height);
  }
}

std::vector<float> read_normals(const fs::path& path, const Scene& scene) {
  const PngImage png = read_png(path);
  check_image_size(png.width, png.height, scene, path);
  if (png.channels != 3) fail(path.string(), "is grey; normals in RGB are expected");
  const auto scale = static_cast<float>(2.0 / ((1 << png.bits) - 1));
  std::vector<float> normals(png.samples.size(), 0.0F);
  for (size_t pixel = 0; pixel < scene.mask.size(); ++pixel) {
    if (scene.mask[pixel] == 0) continue;
    std::array<float, 3> n{};
    for (size_t c = 0; c < 3; ++c) n[c] = static_cast<float>(png.samples[3 * pixel + c]) * scale - 1.0F;
    const float length = std::hypot(n[0], n[1], n[2]);
    if (!(length > 0.5F)) fail(path.string(), "has no normal at pixel {}, on the object", pixel);
    for (size_t c = 0; c < 3; ++c) normals[3 * pixel + c] = n[c] / length;
  }
  return normals;
}

std::vector<float> read_depth(const fs::path& path, const Scene& scene) {
  const NpyArray array = read_npy(path);
  std::vector<int64_t> shape = array.shape;
  if (shape.size() == 3 && shape[2] == 1) shape.pop_back();
  if (shape != std::vector<int64_t>{scene.height, scene.width}) {
    fail(path.string(), "has shape ({}), {} x {} is expected", fmt::join(array.shape, ", "), scene.height,
         scene.width);
  }
  std::vector<float> depth(array.values.size(), 0.0F);
  for (size_t i = 0; i < depth.size(); ++i) {
    if (scene.mask[i] == 0) continue;  // what stands outside the object (often infinity) is of no use
    if (!std::isfinite(array.values[i])) fail(path.string(), "is not finite at pixel {}, on the object", i);
    depth[i] = static_cast<float>(array.values[i]);
  }
  return depth;
}

std::array<float, kShValues> read_sh(const fs::path& path) {
  const NpyArray array = read_npy(path);
  if (array.shape.size() != 2 || array.shape[0] < 9 || array.shape[1] != 3) {
    fail(path.string(), "has shape ({}); at least 9 x 3 coefficients are expected",
         fmt::join(array.shape, ", "));
  }
  std::array<float, kShValues> sh{};
  for (size_t k = 0; k < 9; ++k) {
    for (size_t c = 0; c < 3; ++c) {
      const double value = array.values[3 * k + c];
      if (!std::isfinite(value)) fail(path.string(), "holds a coefficient that is not finite ({})", value);
      sh[9 * c + k] = static_cast<float>(value);
    }
  }
  return sh;
}

class ReleasedSet final : public Dataset {
 public:
  explicit ReleasedSet(const fs::path& root) {
    facts_.layout = "released synthetic";
    facts_.root = root;
    std::string hashes;
    for (const Split split : {Split::kTrain, Split::kTest}) {
      const fs::path csv = root / fmt::format("{}.csv", to_string(split));
      if (!fs::exists(csv)) continue;
      records(split) = read_csv(csv);
      hashes += to_hex(xxh64(read_file(csv)));
    }
    facts_.fingerprint = to_hex(xxh64(std::as_bytes(std::span(hashes))));
    for (const Split split : {Split::kTest, Split::kTrain}) {
      if (records(split).empty()) continue;
      const fs::path image = folder(split, records(split).front()) / "0.png";
      if (!fs::exists(image)) continue;
      const PngSize size = read_png_size(image);
      facts_.width = size.width;
      facts_.height = size.height;
    }
  }

  const DatasetFacts& facts() const override { return facts_; }
  int64_t size(Split split) const override { return static_cast<int64_t>(records(split).size()); }
  std::string id(Split split, int64_t index) const override { return record(split, index).id; }

  Scene load(Split split, int64_t index, const LoadOptions& options) const override {
    const ReleasedRecord& record = this->record(split, index);
    const fs::path folder = this->folder(split, record);
    if (!fs::is_directory(folder)) fail(folder.string(), "scene {} of the index has no folder", record.id);
    const PolariserImages images = read_polariser_images(folder, "");
    Scene scene;
    scene.id = record.id;
    scene.source = folder.string();
    scene.width = images.width;
    scene.height = images.height;
    scene.image = equalised_stokes(images, 1.0F);
    scene.mask =
        erode_mask(read_mask(folder / "mask.png", scene.width, scene.height), scene.width, scene.height);
    // The release has pure-BSDF images for training scenes only.
    if (options.bsdf && (split == Split::kTrain || fs::exists(folder / "0_BSDF.png"))) {
      const PolariserImages bsdf = read_polariser_images(folder, "", "_BSDF");
      check_image_size(bsdf.width, bsdf.height, scene, folder / "0_BSDF.png");
      scene.bsdf = equalised_stokes(bsdf, 1.0F);
    }
    if (options.truth) {
      scene.normal = read_normals(folder / "normal.png", scene);
      scene.depth = read_depth(folder / "depth.npy", scene);
    }
    scene.sh = read_sh(folder / "coeffs.npy");
    scene.flash = record.flash;
    scene.sigma_t = record.sigma_t;
    scene.albedo = record.albedo;
    scene.g = record.g;
    return scene;
  }

  std::optional<StoredLight> load_stored(Split split, int64_t index) const override {
    StoredLight stored;
    stored.polarisers = read_polariser_images(folder(split, record(split, index)), "");
    return stored;
  }

 private:
  std::vector<ReleasedRecord>& records(Split split) { return split == Split::kTrain ? train_ : test_; }
  const std::vector<ReleasedRecord>& records(Split split) const {
    return split == Split::kTrain ? train_ : test_;
  }
  fs::path folder(Split split, const ReleasedRecord& record) const {
    return facts_.root / to_string(split) / record.id;
  }
  const ReleasedRecord& record(Split split, int64_t index) const {
    if (index < 0 || index >= size(split)) {
      fail(facts_.root.string(), "has no scene {} in {} ({} scenes)", index, to_string(split), size(split));
    }
    return records(split)[static_cast<size_t>(index)];
  }

  DatasetFacts facts_;
  std::vector<ReleasedRecord> train_;
  std::vector<ReleasedRecord> test_;
};

}  // namespace

ReleasedRecord parse_released_record(std::string_view line, std::string_view where) {
  const std::vector<std::string_view> cells = split_at(line, ';');
  if (cells.size() != kColumns.size()) {
    fail(where, "has {} columns separated by semicolons; {} are expected ({})", cells.size(), kColumns.size(),
         fmt::join(kColumns, "; "));
  }
  ReleasedRecord record;
  record.id = std::string(trimmed(cells[0]));
  if (record.id.empty() || record.id.find_first_not_of("0123456789") != std::string::npos) {
    fail(where, "column 'scene' is '{}'; a number is expected", record.id);
  }
  record.flash = parse_number(cells[kRadiance], where, kColumns[kRadiance], {0.0F, 1e6F});
  record.sigma_t = parse_triple(cells[kSigmaT], where, kColumns[kSigmaT], {0.0F, 1.0F});
  for (float& value : record.sigma_t) value *= kSigmaTScale;
  record.albedo = parse_triple(cells[kAlbedo], where, kColumns[kAlbedo], {0.0F, 1.0F});
  record.g = parse_number(cells[kG], where, kColumns[kG], {-1.0F, 1.0F});
  return record;
}

std::vector<uint8_t> erode_mask(std::span<const uint8_t> mask, int width, int height) {
  const auto w = static_cast<size_t>(width);
  const auto h = static_cast<size_t>(height);
  std::vector<uint8_t> eroded(w * h, 0);
  for (size_t i = 1; i < h; ++i) {
    for (size_t j = 1; j < w; ++j) {
      const size_t at = i * w + j;
      eroded[at] = mask[at] & mask[at - 1] & mask[at - w] & mask[at - w - 1];
    }
  }
  return eroded;
}

std::unique_ptr<Dataset> open_released_set(const fs::path& root) {
  return std::make_unique<ReleasedSet>(root);
}

}  // namespace opaline
