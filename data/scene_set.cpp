#include "data/scene_set.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <limits>
#include <optional>
#include <span>

#include "core/error.h"
#include "core/file.h"
#include "data/scene_channels.h"
#include "data/scene_index.h"
#include "data/toml_config.h"

namespace opaline {
namespace {

namespace fs = std::filesystem;

constexpr float kSigmaTScale = 32.0F;
constexpr int kFormatVersion = 1;
constexpr float kMost = std::numeric_limits<float>::max();

// What we write; a reader converts the alternatives of the first three and refuses anything else.
constexpr std::string_view kS1 = "I0 - I90";
constexpr std::string_view kS1Flipped = "I90 - I0";
constexpr std::string_view kS2 = "I45 - I135";
constexpr std::string_view kS2Flipped = "I135 - I45";
constexpr std::string_view kSigmaT = "per metre";
constexpr std::string_view kSigmaTNormalised = "divided by 32";
constexpr std::string_view kLight = "linear, S0 = 2 is white";
constexpr std::string_view kAngles = "0 along image x, counter-clockwise as seen";
constexpr std::string_view kAxes = "camera: x right, y up, z towards the camera";
constexpr std::string_view kDepth = "z / 0.25 m, larger is nearer";
constexpr std::string_view kSh =
    "real, orthonormal, no Condon-Shortley sign, (0,0) (1,-1) (1,0) (1,1) (2,-2) .. (2,2), polar axis z";

/// Which conversions a set needs.
struct Conventions {
  float s1 = 1.0F;  ///< factor on S1
  float s2 = 1.0F;
  float sigma_t = 1.0F;
};

struct SetFile {
  SceneSetInfo info;
  Conventions conventions;
};

std::string quote(std::string_view text) {
  std::string quoted = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') {
      quoted += '\\';
      quoted += c;
    } else if (c == '\n') {
      quoted += "\\n";
    } else if (static_cast<unsigned char>(c) < 0x20 || c == 0x7f) {
      quoted += fmt::format("\\u{:04X}", static_cast<unsigned>(c));
    } else {
      quoted += c;
    }
  }
  return quoted + '"';
}

float sign_of(const TomlTable& table, std::string_view key, std::string_view ours, std::string_view flipped) {
  const std::array<std::string_view, 2> choices = {ours, flipped};
  return table.choice(key, ours, choices) == ours ? 1.0F : -1.0F;
}

void expect(const TomlTable& table, std::string_view key, std::string_view ours) {
  table.choice(key, ours, {&ours, 1});
}

/// A text, as TOML's integers are signed.
uint64_t parse_seed(const TomlTable& table) {
  const std::string text = table.text("seed", "0");
  uint64_t seed = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), seed);
  if (error != std::errc() || end != text.data() + text.size()) table.error("seed", "is not a whole number");
  return seed;
}

SetFile read_set_file(const fs::path& root) {
  // A bad dataset.toml is damaged data (exit code 1), not a config the user wrote (2).
  try {
    TomlConfig config = TomlConfig::from_file(root / "dataset.toml");
    const TomlTable top = config.root();
    SetFile file;
    SceneSetInfo& info = file.info;
    top.integer("version", kFormatVersion, {.min = kFormatVersion, .max = kFormatVersion});
    info.generator = top.text("generator", info.generator);
    info.generator_version = top.text("generator_version", "");
    info.seed = parse_seed(top);
    info.train = top.integer("train", 0, {.min = 0});
    info.test = top.integer("test", 0, {.min = 0});
    info.width = static_cast<int>(top.integer("width", 0, {.min = 1, .max = ExrLimits().max_side}));
    info.height = static_cast<int>(top.integer("height", 0, {.min = 1, .max = ExrLimits().max_side}));
    for (const char* key : {"version", "width", "height"}) top.require(key);
    constexpr std::array<std::string_view, 2> kReadings = {"clear", "reflection"};
    info.bsdf = top.choice("bsdf", "clear", kReadings);
    info.config_text = top.text("config", "");
    const TomlTable conventions = top.table("conventions");
    file.conventions.s1 = sign_of(conventions, "s1", kS1, kS1Flipped);
    file.conventions.s2 = sign_of(conventions, "s2", kS2, kS2Flipped);
    const std::array<std::string_view, 2> units = {kSigmaT, kSigmaTNormalised};
    if (conventions.choice("sigma_t", kSigmaT, units) != kSigmaT) file.conventions.sigma_t = kSigmaTScale;
    expect(conventions, "light", kLight);
    expect(conventions, "angles", kAngles);
    expect(conventions, "axes", kAxes);
    expect(conventions, "depth", kDepth);
    expect(conventions, "sh", kSh);
    config.finish();
    return file;
  } catch (const UsageError& e) {
    throw Error(e.what());
  }
}

/// Calls put(x, y, values of the part there) where the part lies on a window of the image.
template <class Put>
void for_each_pixel(const ExrPart& part, const Window& window, const Put& put) {
  const Window& w = part.window;
  for (int y = std::max(w.y0, window.y0); y < std::min(w.y1, window.y1); ++y) {
    for (int x = std::max(w.x0, window.x0); x < std::min(w.x1, window.x1); ++x) {
      put(x, y, part.pixels.data() + w.at(x, y) * part.channels.size());
    }
  }
}

/// The box of tiles around a box of pixels, with `dilation` tiles more, grown by a pixel: a sensor's mosaic
/// looks one pixel further.
Window support_box(const Window& box, int64_t dilation, const Window& whole) {
  constexpr int kTile = 16;
  const auto around = static_cast<int>(std::min<int64_t>(dilation, (whole.x1 + whole.y1) / kTile)) * kTile;
  const Window tiles{box.x0 / kTile * kTile, box.y0 / kTile * kTile, (box.x1 + kTile - 1) / kTile * kTile,
                     (box.y1 + kTile - 1) / kTile * kTile};
  return grown(tiles, around + 1, whole.x1, whole.y1);
}

/// Applies the sign conventions to the light of a window and refuses light that cannot be.
void convert_light(std::vector<float>& stokes, const Window& window, const Conventions& conventions,
                   const Scene& scene, std::string_view part) {
  if (conventions.s1 != 1.0F || conventions.s2 != 1.0F) {
    for (size_t i = 0; i < stokes.size(); ++i) {
      const size_t c = i % kStokesChannels;
      stokes[i] *= c < 3 ? 1.0F : c < 6 ? conventions.s1 : conventions.s2;
    }
  }
  // Sound light, the rule, is told without a branch a value.
  constexpr std::array<float, kStokesChannels> kLeast = {0,      0,      0,      -kMost, -kMost,
                                                         -kMost, -kMost, -kMost, -kMost};
  const auto is_light = [&](const float* s) {
    int good = 1;
    for (size_t c = 0; c < kStokesChannels; ++c) good &= int{s[c] >= kLeast[c]} & int{s[c] <= kMost};
    return good != 0;
  };
  for (int64_t i = 0; i < window.pixels(); ++i) {
    const float* s = stokes.data() + i * kStokesChannels;
    if (is_light(s)) continue;
    fail(scene.source, "scene {}, part '{}', pixel ({}, {}): S = ({}) is not light", scene.id, part,
         window.x0 + i % window.width(), window.y0 + i / window.width(),
         fmt::join(std::span(s, kStokesChannels), ", "));
  }
}

/// The bytes of a scene's file that a load needs.
class SceneFile {
 public:
  SceneFile(const fs::path& path, const SceneRecord& record, const LoadOptions& options) {
    const bool whole = options.whole || options.bsdf;
    if (!record.sections || (whole && options.bsdf)) {
      bytes_.push_back(read_file(path));
      size_ = static_cast<int64_t>(bytes_.back().size());
      check(path, record, "its", bytes_.back(), record.xxh64);
      pieces_.push_back({0, bytes_.back()});
      return;
    }
    const FileReader file(path);
    size_ = file.size();
    int64_t declared = 0;
    for (const FileSection& section : *record.sections) declared += section.bytes;
    if (declared != size_) {
      fail(path.string(), "scene {} is damaged: it has {} bytes, the index says {}", record.id, size_,
           declared);
    }
    bytes_.reserve(kSceneSections);  // pieces look into them
    int64_t offset = 0;
    for (size_t i = 0; i < kSceneSections; ++i) {
      const FileSection& section = (*record.sections)[i];
      const auto kind = static_cast<SceneSection>(i);
      const bool around = kind == SceneSection::kAbove || kind == SceneSection::kBelow;
      if (section.bytes > 0 && kind != SceneSection::kBsdf && (whole || !around)) {
        std::vector<std::byte>& bytes = bytes_.emplace_back(static_cast<size_t>(section.bytes));
        file.read(offset, bytes);
        check(path, record, fmt::format("section {}'s", i), bytes, section.xxh64);
        pieces_.push_back({offset, bytes});
      }
      offset += section.bytes;
    }
  }

  std::span<const ExrBytes> pieces() const { return pieces_; }
  int64_t size() const { return size_; }

 private:
  static void check(const fs::path& path, const SceneRecord& record, std::string_view what,
                    std::span<const std::byte> bytes, const std::string& expected) {
    const std::string hash = to_hex(xxh64(bytes));
    if (hash != expected) {
      fail(path.string(), "scene {} is damaged: {} checksum is {}, the index says {}", record.id, what, hash,
           expected);
    }
  }

  std::vector<std::vector<std::byte>> bytes_;
  std::vector<ExrBytes> pieces_;
  int64_t size_ = 0;
};

class SceneSet final : public Dataset {
 public:
  explicit SceneSet(const fs::path& root) : set_(read_set_file(root)) {
    facts_.layout = "opaline";
    facts_.root = root;
    facts_.width = set_.info.width;
    facts_.height = set_.info.height;
    uint64_t hash = xxh64(read_file(root / "dataset.toml"));
    for (const Split split : {Split::kTrain, Split::kTest}) {
      const fs::path path = root / fmt::format("{}.jsonl", to_string(split));
      if (!fs::exists(path)) continue;
      index_of(split).emplace(path);
      const std::string joined = to_hex(hash) + to_hex(index_of(split)->xxh64());
      hash = xxh64(std::as_bytes(std::span(joined)));
    }
    facts_.fingerprint = to_hex(hash);
  }

  const DatasetFacts& facts() const override { return facts_; }
  int64_t size(Split split) const override {
    const std::optional<SceneIndex>& index = index_of(split);
    return index ? index->size() : 0;
  }
  std::string id(Split split, int64_t index) const override { return record(split, index).id; }

  Scene load(Split split, int64_t index, const LoadOptions& options) const override {
    const SceneRecord record = this->record(split, index);
    const fs::path path = facts_.root / record.file;
    const SceneFile file(path, record, options);
    const ExrReader reader(file.pieces(), file.size(), path.string());
    Scene scene;
    scene.id = record.id;
    scene.source = path.string();
    scene.width = reader.width();
    scene.height = reader.height();
    if (scene.width != facts_.width || scene.height != facts_.height) {
      fail(path.string(), "scene {} has {} x {} pixels, the data set {} x {}", scene.id, scene.width,
           scene.height, facts_.width, facts_.height);
    }
    read_images(reader, options, scene);
    read_truth(reader, options, scene);
    take_parameters(record, scene);
    return scene;
  }

 private:
  std::optional<SceneIndex>& index_of(Split split) { return split == Split::kTrain ? train_ : test_; }
  const std::optional<SceneIndex>& index_of(Split split) const {
    return split == Split::kTrain ? train_ : test_;
  }

  SceneRecord record(Split split, int64_t index) const {
    if (index < 0 || index >= size(split)) {
      fail(facts_.root.string(), "has no scene {} in {} ({} scenes)", index, to_string(split), size(split));
    }
    return index_of(split)->record(index);
  }

  void read_images(const ExrReader& reader, const LoadOptions& options, Scene& scene) const {
    const Window whole{0, 0, scene.width, scene.height};
    const Window box = object_box(reader, whole);
    if (options.support) scene.object = support_box(box, *options.support, whole);
    if (!options.whole) {
      scene.window = options.bsdf ? scene.object : grown(box, 1, scene.width, scene.height);
    }
    const Window wanted = scene.image_window();
    ExrPart image = reader.read("image", kStokesNames, ExrRows{wanted.y0, wanted.y1});
    if (image.window == wanted) {
      scene.image = std::move(image.pixels);
    } else if (image.window == Window{0, wanted.y0, scene.width, wanted.y1}) {
      scene.image.reserve(static_cast<size_t>(wanted.pixels()) * kStokesChannels);
      append_window(image.pixels, image.window, wanted, scene.image);
    } else {
      fail(scene.source, "part 'image' has window {} where {} is expected", to_string(image.window),
           to_string(Window{0, wanted.y0, scene.width, wanted.y1}));
    }
    convert_light(scene.image, wanted, set_.conventions, scene, "image");
    if (!options.bsdf) return;
    ExrPart bsdf = reader.read("bsdf", kStokesNames);
    convert_light(bsdf.pixels, bsdf.window, set_.conventions, scene, "bsdf");
    // Outside the window there is no object, so both renderings see the same.
    const Window object = scene.object_window();
    append_window(scene.image, wanted, object, scene.bsdf);
    for_each_pixel(bsdf, object, [&](int x, int y, const float* values) {
      std::copy_n(values, kStokesChannels, scene.bsdf.data() + object.at(x, y) * kStokesChannels);
    });
  }

  /// The pixels of `part` out of Stokes values of a window that contains it.
  static void append_window(const std::vector<float>& values, const Window& window, const Window& part,
                            std::vector<float>& to) {
    to.reserve(to.size() + static_cast<size_t>(part.pixels()) * kStokesChannels);
    for (int y = part.y0; y < part.y1; ++y) {
      const auto row = values.begin() + static_cast<std::ptrdiff_t>(window.at(part.x0, y) * kStokesChannels);
      to.insert(to.end(), row, row + std::ptrdiff_t{part.width()} * kStokesChannels);
    }
  }

  /// The box of the object, which is part truth's, inside the image.
  static Window object_box(const ExrReader& reader, const Window& whole) {
    for (const ExrPartInfo& part : reader.parts()) {
      if (part.name != "truth") continue;
      const Window window = grown(part.window, 0, whole.x1, whole.y1);
      if (window.width() > 0 && window.height() > 0) return window;
    }
    return whole;  // reading it will say what is wrong
  }

  static void read_truth(const ExrReader& reader, const LoadOptions& options, Scene& scene) {
    const Window whole{0, 0, scene.width, scene.height};
    scene.mask.assign(static_cast<size_t>(scene.pixels()), 0);
    const ExrPart truth = reader.read("truth", options.truth ? kTruthNames : kMaskName);
    if (!options.truth) {
      for_each_pixel(truth, whole, [&](int x, int y, const float* values) {
        scene.mask[whole.at(x, y)] = values[0] == 1.0F ? 1 : 0;
      });
      return;
    }
    const Window object = scene.object_window();
    scene.normal.assign(3 * static_cast<size_t>(object.pixels()), 0.0F);
    scene.depth.assign(static_cast<size_t>(object.pixels()), 0.0F);
    for_each_pixel(truth, object, [&](int x, int y, const float* values) {
      if (values[4] != 1.0F) return;
      scene.mask[whole.at(x, y)] = 1;
      scene.depth[object.at(x, y)] = values[3];
      const float length = std::hypot(values[0], values[1], values[2]);
      if (!(length > 0.5F && length < 2.0F && std::isfinite(values[3]))) {
        fail(scene.source, "scene {}, pixel ({}, {}): normal ({}, {}, {}) and depth {} are no surface",
             scene.id, x, y, values[0], values[1], values[2], values[3]);
      }
      for (size_t c = 0; c < 3; ++c) {
        scene.normal[3 * object.at(x, y) + c] = values[c] / length;  // half floats round
      }
    });
  }

  void take_parameters(const SceneRecord& record, Scene& scene) const {
    const auto to_float = [](double x) { return static_cast<float>(x); };
    scene.sh.emplace();
    std::transform(record.sh.begin(), record.sh.end(), scene.sh->begin(), to_float);
    scene.flash = to_float(record.flash);
    scene.sigma_t.emplace();
    scene.albedo.emplace();
    for (size_t c = 0; c < 3; ++c) {
      (*scene.sigma_t)[c] = to_float(record.sigma_t[c]) * set_.conventions.sigma_t;
      (*scene.albedo)[c] = to_float(record.albedo[c]);
    }
    scene.g = to_float(record.g);
  }

  SetFile set_;
  DatasetFacts facts_;
  std::optional<SceneIndex> train_;
  std::optional<SceneIndex> test_;
};

}  // namespace

void write_scene_set_info(const fs::path& root, const SceneSetInfo& info) {
  std::string text = "# A set of polarised scenes; see docs/formats.md.\n";
  const auto line = [&](std::string_view key, const std::string& value) {
    text += fmt::format("{} = {}\n", key, value);
  };
  line("version", fmt::format("{}", kFormatVersion));
  line("generator", quote(info.generator));
  line("generator_version", quote(info.generator_version));
  line("seed", quote(fmt::format("{}", info.seed)));
  line("train", fmt::format("{}", info.train));
  line("test", fmt::format("{}", info.test));
  line("width", fmt::format("{}", info.width));
  line("height", fmt::format("{}", info.height));
  line("bsdf", quote(info.bsdf));
  line("config", quote(info.config_text));
  text += "\n[conventions]\n";
  line("light", quote(kLight));
  line("s1", quote(kS1));
  line("s2", quote(kS2));
  line("angles", quote(kAngles));
  line("axes", quote(kAxes));
  line("depth", quote(kDepth));
  line("sigma_t", quote(kSigmaT));
  line("sh", quote(kSh));
  write_file_atomically(root / "dataset.toml", text);
}

SceneSetInfo read_scene_set_info(const fs::path& root) {
  return read_set_file(root).info;
}

std::unique_ptr<Dataset> open_scene_set(const fs::path& root) {
  return std::make_unique<SceneSet>(root);
}

}  // namespace opaline
