#include "data/capture.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/error.h"
#include "core/file.h"
#include "data/npy.h"
#include "data/png.h"

namespace opaline {
namespace {

namespace fs = std::filesystem;

constexpr std::array<int, 4> kAngles = {0, 45, 90, 135};
constexpr double kGamma = 2.2;
// Beside which the 8 bits tell too little of a ratio, and from which the sensor may have clipped (of 255).
constexpr double kDark = 20;
constexpr double kBright = 254;

/// Linear light of every sample value.
std::vector<float> decode_table(int bits) {
  const int count = 1 << bits;
  std::vector<float> table(static_cast<size_t>(count));
  for (int v = 0; v < count; ++v) {
    table[static_cast<size_t>(v)] =
        static_cast<float>(std::min(1.0, std::pow((v + 0.5) / (count - 1), kGamma)));
  }
  return table;
}

/// The pair's mean over each pair, for a ratio (I45 + I135) / (I0 + I90).
struct PairScale {
  float s1 = 1.0F;
  float s2 = 1.0F;
};

PairScale pair_scale(float ratio) {
  return {(1.0F + ratio) / 2.0F, (1.0F + 1.0F / ratio) / 2.0F};
}

/// <folder>/<name>: H x W x 3 linear values, or nothing where the file is not there.
std::vector<float> read_stokes_npy(const fs::path& path, const PolariserImages& images) {
  if (!fs::exists(path)) return {};
  const NpyArray array = read_npy(path);
  const std::vector<int64_t> expected = {images.height, images.width, 3};
  if (array.shape != expected) {
    fail(path.string(), "has shape ({}), the polariser images need ({})", fmt::join(array.shape, ", "),
         fmt::join(expected, ", "));
  }
  std::vector<float> values;
  values.reserve(array.values.size());
  for (const double value : array.values) {
    if (!std::isfinite(value)) fail(path.string(), "holds a value that is not finite ({})", value);
    values.push_back(static_cast<float>(value));
  }
  return values;
}

/// +1 or -1: whether `stored` goes with or against the difference of two images. Values of no agreement at
/// all (|correlation| under a half) mean that the files do not belong together.
float sign_against(std::span<const float> stored, std::span<const float> a, std::span<const float> b,
                   const fs::path& path) {
  double with = 0;
  double stored2 = 0;
  double difference2 = 0;
  for (size_t i = 0; i < stored.size(); ++i) {
    const double difference = static_cast<double>(a[i]) - static_cast<double>(b[i]);
    const auto value = static_cast<double>(stored[i]);
    with += difference * value;
    stored2 += value * value;
    difference2 += difference * difference;
  }
  const double scale = std::sqrt(stored2 * difference2);
  if (scale == 0) return 1.0F;
  const double correlation = with / scale;
  if (!(std::abs(correlation) > 0.5)) {
    fail(path.string(), "does not match the polariser images (correlation {:.2f})", correlation);
  }
  return correlation > 0 ? 1.0F : -1.0F;
}

/// The light of s0.npy .. s2.npy in our signs, pairs equalised; empty where a file is missing.
std::vector<float> stokes_from_npy(const fs::path& folder, const PolariserImages& images, float ratio) {
  std::array<std::vector<float>, 3> s;
  for (size_t i = 0; i < 3; ++i) {
    s[i] = read_stokes_npy(folder / fmt::format("s{}.npy", i), images);
    if (s[i].empty()) return {};
  }
  const float sign1 = sign_against(s[1], images.images[0], images.images[2], folder / "s1.npy");
  const float sign2 = sign_against(s[2], images.images[1], images.images[3], folder / "s2.npy");
  const PairScale scale = pair_scale(ratio);
  std::vector<float> stokes(3 * s[0].size());
  for (size_t i = 0; i < s[0].size(); ++i) {
    const size_t at = i / 3 * kStokesChannels + i % 3;
    if (!(s[0][i] >= 0.0F)) fail((folder / "s0.npy").string(), "holds negative light ({})", s[0][i]);
    stokes[at] = s[0][i];
    stokes[at + 3] = sign1 * scale.s1 * s[1][i];
    stokes[at + 6] = sign2 * scale.s2 * s[2][i];
  }
  return stokes;
}

bool is_capture(const fs::path& folder) {
  return std::any_of(kAngles.begin(), kAngles.end(),
                     [&](int angle) { return fs::exists(folder / fmt::format("p{}.png", angle)); });
}

/// Numbers in their order, then names.
bool name_before(const fs::path& a, const fs::path& b) {
  const std::string x = a.filename().string();
  const std::string y = b.filename().string();
  const auto is_number = [](const std::string& s) {
    return !s.empty() && s.find_first_not_of("0123456789") == std::string::npos;
  };
  if (is_number(x) != is_number(y)) return is_number(x);
  if (is_number(x) && x.size() != y.size()) return x.size() < y.size();
  return x < y;
}

class Captures final : public Dataset {
 public:
  explicit Captures(const fs::path& root) {
    facts_.layout = "capture";
    facts_.root = root;
    if (is_capture(root)) {
      folders_.push_back(root);
    } else {
      for (const fs::directory_entry& entry : fs::directory_iterator(root)) {
        if (entry.is_directory() && is_capture(entry.path())) folders_.push_back(entry.path());
      }
    }
    std::sort(folders_.begin(), folders_.end(), name_before);
    std::string names;
    bool same = true;
    PngSize first;
    for (const fs::path& folder : folders_) {
      names += folder.filename().string() + "\n";
      const fs::path image = folder / "p0.png";
      const PngSize size = fs::exists(image) ? read_png_size(image) : PngSize{};
      if (folder == folders_.front()) first = size;
      same = same && size == first;
    }
    facts_.width = same ? first.width : 0;
    facts_.height = same ? first.height : 0;
    facts_.fingerprint = to_hex(xxh64(std::as_bytes(std::span(names))));
  }

  const DatasetFacts& facts() const override { return facts_; }
  int64_t size(Split split) const override {
    return split == Split::kTest ? static_cast<int64_t>(folders_.size()) : 0;
  }
  std::string id(Split split, int64_t index) const override {
    const fs::path absolute = fs::absolute(folder(split, index)).lexically_normal();
    return absolute.has_filename() ? absolute.filename().string()
                                   : absolute.parent_path().filename().string();
  }
  Scene load(Split split, int64_t index, const LoadOptions&) const override {
    Scene scene = read_capture(folder(split, index));
    scene.id = id(split, index);
    return scene;
  }
  std::optional<StoredLight> load_stored(Split split, int64_t index) const override {
    return read_stored_capture(folder(split, index));
  }

 private:
  const fs::path& folder(Split split, int64_t index) const {
    if (index < 0 || index >= size(split)) {
      fail(facts_.root.string(), "has no capture {} in {} ({} captures)", index, to_string(split),
           size(split));
    }
    return folders_[static_cast<size_t>(index)];
  }

  DatasetFacts facts_;
  std::vector<fs::path> folders_;
};

}  // namespace

PolariserImages read_polariser_images(const fs::path& folder, std::string_view prefix,
                                      std::string_view suffix) {
  PolariserImages result;
  for (size_t angle = 0; angle < kAngles.size(); ++angle) {
    const fs::path path = folder / fmt::format("{}{}{}.png", prefix, kAngles[angle], suffix);
    if (!fs::exists(path)) {
      fail(folder.string(), "the image of {} degrees is missing ({}); four angles are needed", kAngles[angle],
           path.filename().string());
    }
    const PngImage png = read_png(path);
    if (angle == 0) {
      result.width = png.width;
      result.height = png.height;
      result.clipped.assign(static_cast<size_t>(3 * result.pixels()), 0);
    }
    if (png.width != result.width || png.height != result.height) {
      fail(path.string(), "has {} x {} pixels, the image of 0 degrees {} x {}", png.width, png.height,
           result.width, result.height);
    }
    if (png.channels != 3) fail(path.string(), "is grey; a colour image is expected");
    const std::vector<float> table = decode_table(png.bits);
    const double bright = kBright / 255 * ((1 << png.bits) - 1);
    std::vector<float>& image = result.images[angle];
    image.resize(png.samples.size());
    for (size_t i = 0; i < image.size(); ++i) {
      image[i] = table[png.samples[i]];
      if (static_cast<double>(png.samples[i]) >= bright) result.clipped[i] = 1;
    }
  }
  return result;
}

float pair_ratio(const PolariserImages& images, std::span<const uint8_t> mask) {
  const auto dark = static_cast<float>(std::pow(kDark / 255, kGamma));
  std::vector<float> ratios;
  const auto& [i0, i45, i90, i135] = images.images;
  for (size_t i = 0; i < i0.size(); ++i) {
    if (mask[i / 3] == 0 || images.clipped[i] != 0) continue;
    if (std::min({i0[i], i45[i], i90[i], i135[i]}) < dark) continue;
    ratios.push_back((i45[i] + i135[i]) / (i0[i] + i90[i]));
  }
  if (ratios.empty()) return 1.0F;
  const auto middle = ratios.begin() + static_cast<std::ptrdiff_t>(ratios.size() / 2);
  std::nth_element(ratios.begin(), middle, ratios.end());
  return *middle;
}

std::vector<float> equalised_stokes(const PolariserImages& images, float ratio) {
  const PairScale scale = pair_scale(ratio);
  const auto& [i0, i45, i90, i135] = images.images;
  std::vector<float> stokes(3 * i0.size());
  for (size_t i = 0; i < i0.size(); ++i) {
    const size_t at = i / 3 * kStokesChannels + i % 3;
    stokes[at] = (scale.s1 * (i0[i] + i90[i]) + scale.s2 * (i45[i] + i135[i])) / 2.0F;
    stokes[at + 3] = scale.s1 * (i0[i] - i90[i]);
    stokes[at + 6] = scale.s2 * (i45[i] - i135[i]);
  }
  return stokes;
}

std::vector<uint8_t> read_mask(const fs::path& path, int width, int height) {
  const PngImage png = read_png(path);
  if (png.width != width || png.height != height) {
    fail(path.string(), "has {} x {} pixels, the images {} x {}", png.width, png.height, width, height);
  }
  const int object = (1 << png.bits) - 1;
  std::vector<uint8_t> mask(static_cast<size_t>(width) * static_cast<size_t>(height));
  for (size_t i = 0; i < mask.size(); ++i) {
    mask[i] = png.samples[i * static_cast<size_t>(png.channels)] == object ? 1 : 0;
  }
  return mask;
}

StoredLight read_stored_capture(const fs::path& folder) {
  StoredLight stored;
  stored.polarisers = read_polariser_images(folder, "p");
  for (size_t i = 0; i < 3; ++i) {
    stored.stokes[i] = read_stokes_npy(folder / fmt::format("s{}.npy", i), stored.polarisers);
  }
  return stored;
}

Scene read_capture(const fs::path& folder) {
  const PolariserImages images = read_polariser_images(folder, "p");
  Scene scene;
  scene.id = folder.filename().string();
  scene.source = folder.string();
  scene.width = images.width;
  scene.height = images.height;
  const fs::path mask = folder / "mask.png";
  if (!fs::exists(mask)) fail(folder.string(), "mask.png is missing: paint the object 255, the rest 0");
  scene.mask = read_mask(mask, images.width, images.height);
  if (std::find(scene.mask.begin(), scene.mask.end(), 1) == scene.mask.end()) {
    fail(mask.string(), "marks no object: no pixel is 255");
  }
  const float ratio = pair_ratio(images, scene.mask);
  scene.pair_ratio = ratio;
  scene.image = stokes_from_npy(folder, images, ratio);
  if (scene.image.empty()) scene.image = equalised_stokes(images, ratio);
  return scene;
}

bool has_captures(const fs::path& root) {
  if (is_capture(root)) return true;
  for (const fs::directory_entry& entry : fs::directory_iterator(root)) {
    if (entry.is_directory() && is_capture(entry.path())) return true;
  }
  return false;
}

std::unique_ptr<Dataset> open_captures(const fs::path& root) {
  return std::make_unique<Captures>(root);
}

}  // namespace opaline
