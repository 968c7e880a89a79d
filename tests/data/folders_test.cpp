// The released layouts: synthetic set and captures.
#include <fstream>

#include "data/capture.h"
#include "data/encode.h"
#include "data/npy.h"
#include "data/png.h"
#include "data/released.h"
#include "tests/data/support.h"

namespace opaline::test {
namespace {

namespace fs = std::filesystem;

constexpr int kSize = 32;
const std::string kLine = "7;obj;env;bump;50;0.5,0.25,1;0.4,0.5,0.6;0.3;1;0;0;0;0;0;0;0;90;0;1";

std::string with_scene(char name) {
  std::string line = kLine;
  line[0] = name;
  return line;
}

/// Encoded, truncated polariser images of linear light, as the release's files were written.
void write_polarisers(const fs::path& folder, const std::vector<float>& stokes, const std::string& prefix,
                      const std::string& suffix = "", float gain45 = 1.0F) {
  const std::vector<float> images = polariser_images(stokes);
  const std::array<const char*, 4> angles = {"0", "45", "90", "135"};
  for (size_t angle = 0; angle < 4; ++angle) {
    std::vector<uint8_t> bytes;
    for (size_t i = 0; i < images.size() / 12; ++i) {
      for (size_t c = 0; c < 3; ++c) {
        const float gain = angle % 2 == 1 ? gain45 : 1.0F;
        bytes.push_back(static_cast<uint8_t>(255.0F * encode_gamma(gain * images[12 * i + 3 * angle + c])));
      }
    }
    write_png(folder / (prefix + angles[angle] + suffix + ".png"), kSize, kSize, 3, bytes);
  }
}

/// Stokes light that no polariser image clips or leaves dark.
std::vector<float> moderate_light(uint32_t variant = 0) {
  Random random(31, Purpose::kTest, 0, variant);
  std::vector<float> stokes;
  for (int i = 0; i < kSize * kSize; ++i) {
    for (int c = 0; c < 3; ++c) stokes.push_back(0.6F + 0.8F * random.uniform_float());
    for (int c = 0; c < 6; ++c) stokes.push_back(0.3F * random.uniform_float() - 0.1F);
  }
  return stokes;
}

std::vector<uint8_t> disc_mask() {
  std::vector<uint8_t> mask;
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      const int r2 = (2 * x - kSize + 1) * (2 * x - kSize + 1) + (2 * y - kSize + 1) * (2 * y - kSize + 1);
      mask.push_back(r2 < 400 ? 255 : r2 < 500 ? 128 : 0);
    }
  }
  return mask;
}

void write_released_scene(const fs::path& folder, bool bsdf) {
  fs::create_directories(folder);
  write_polarisers(folder, moderate_light(), "");
  if (bsdf) write_polarisers(folder, moderate_light(1), "", "_BSDF");
  write_png(folder / "mask.png", kSize, kSize, 1, disc_mask());
  std::vector<uint8_t> normals;
  std::vector<float> depth;
  for (int i = 0; i < kSize * kSize; ++i) {
    normals.insert(normals.end(), {uint8_t{204}, uint8_t{128}, uint8_t{230}});  // 0.6, 0, 0.8
    depth.push_back(0.5F + 0.001F * static_cast<float>(i));
  }
  write_png(folder / "normal.png", kSize, kSize, 3, normals);
  depth[0] = std::numeric_limits<float>::infinity();  // as released files have it off the object
  write_npy(folder / "depth.npy", depth, std::vector<int64_t>{kSize, kSize});
  std::vector<float> coefficients;
  for (int i = 0; i < 16 * 3; ++i) coefficients.push_back(static_cast<float>(i));
  write_npy(folder / "coeffs.npy", coefficients, std::vector<int64_t>{16, 3});
}

void write_text(const fs::path& path, const std::string& text) {
  write_file_atomically(path, std::string_view(text));
}

void write_released_set(const fs::path& root) {
  write_text(root / "train.csv", kLine + "\n");
  write_text(root / "test.csv", with_scene('8') + "\r\n\n");
  write_released_scene(root / "train" / "7", true);
  write_released_scene(root / "test" / "8", false);
}

TEST_CASE("the released set is read in our units", "[released]") {
  const TempFolder folder;
  write_released_set(folder.path());
  const auto set = open_dataset(folder.path());
  CHECK(set->facts().layout == "released synthetic");
  CHECK(set->facts().width == kSize);
  CHECK(set->size(Split::kTrain) == 1);
  CHECK(set->size(Split::kTest) == 1);
  const Scene scene = set->load(Split::kTrain, 0);
  CHECK(scene.id == "7");
  CHECK(*scene.flash == 50.0F);
  CHECK(*scene.sigma_t == std::array<float, 3>{16.0F, 8.0F, 32.0F});
  CHECK(*scene.albedo == std::array<float, 3>{0.4F, 0.5F, 0.6F});
  CHECK(*scene.g == 0.3F);
  // Row k, column c of the file is coefficient k of colour c.
  CHECK((*scene.sh)[9 * 2 + 4] == 3 * 4 + 2);
  const std::vector<float> expected = moderate_light();
  double error = 0;
  double total = 0;
  for (size_t i = 0; i < expected.size(); i += 9) {
    error += std::abs(static_cast<double>(scene.image[i]) - static_cast<double>(expected[i]));
    total += static_cast<double>(expected[i]);
    REQUIRE(std::abs(scene.image[i + 3] - expected[i + 3]) < 0.02F);
    REQUIRE(std::abs(scene.image[i + 7] - expected[i + 7]) < 0.02F);
  }
  CHECK(error / total < 4e-3);
  CHECK(scene.bsdf.size() == scene.image.size());
  const size_t middle = kSize * kSize / 2 + kSize / 2;
  CHECK(scene.mask[middle] == 1);
  CHECK(std::abs(scene.normal[3 * middle] - 0.6F) < 0.01F);
  CHECK(std::abs(scene.normal[3 * middle + 2] - 0.8F) < 0.01F);
  CHECK(scene.depth[middle] == 0.5F + 0.001F * static_cast<float>(middle));
  CHECK(scene.depth[0] == 0.0F);
  CHECK(set->load(Split::kTest, 0).bsdf.empty());
}

TEST_CASE("a released image comes back to the level it stored", "[released]") {
  const TempFolder folder;
  write_released_set(folder.path());
  const Scene scene = open_dataset(folder.path())->load(Split::kTrain, 0);
  const PngImage stored = read_png(folder / "train/7/0.png");
  EncodeOptions options = EncodeOptions::release();
  const Sample sample = encode_scene(scene, options);
  int off = 0;
  int compared = 0;
  for (size_t i = 0; i < scene.mask.size(); ++i) {
    if (scene.mask[i] == 0) continue;
    for (size_t c = 0; c < 3; ++c) {
      const double level = (sample.input.at(static_cast<int64_t>(21 * i + c)) + 1) / 2 * 255;
      const double difference = std::abs(level - stored.samples[3 * i + c]);
      REQUIRE(difference < 1.01);
      off += difference > 0.01 ? 1 : 0;
      ++compared;
    }
  }
  // Only where 8 bits made I0 + I90 differ from I45 + I135 by enough to cross a level.
  CHECK(off < compared / 50);
}

TEST_CASE("the release's erosion drops the first row and column of the object", "[released]") {
  const std::vector<uint8_t> mask = {1, 1, 1, 0,  //
                                     1, 1, 1, 0,  //
                                     0, 1, 1, 1};
  const std::vector<uint8_t> expected = {0, 0, 0, 0,  //
                                         0, 1, 1, 0,  //
                                         0, 0, 1, 0};
  CHECK(erode_mask(mask, 4, 3) == expected);
}

TEST_CASE("a bad line of the CSV is refused with file, line and column", "[released]") {
  const auto refusal = [](const std::string& line) {
    const std::string message = message_of([&] { parse_released_record(line, "train.csv:3"); });
    CHECK(contains(message, "train.csv:3"));
    return message;
  };
  const auto with = [](const std::string& from, const std::string& to) {
    std::string line = kLine;
    return line.replace(line.find(from), from.size(), to);
  };
  CHECK(contains(refusal("7,obj,env"), "1 columns separated by semicolons; 19"));
  CHECK(contains(refusal(kLine + ";1"), "20 columns"));
  CHECK(contains(refusal(with("0.5,0.25,1", "0,5,0,25,1")), "'sigma_t'"));
  CHECK(contains(refusal(with(";0.3;", ";0,3;")), "'g' holds '0,3'"));
  CHECK(contains(refusal(with(";0.3;", ";nan;")), "'g' is nan"));
  CHECK(contains(refusal(with("0.5,0.25,1", "0.5,0.25,1.5")), "'sigma_t' is 1.5"));
  CHECK(contains(refusal(with("0.4,", "-0.4,")), "'albedo' is -0.4"));
  CHECK(contains(refusal(with_scene('x')), "'scene' is 'x'"));
}

TEST_CASE("damaged CSV lines are parsed or refused, never more", "[released][fuzz]") {
  const auto bytes = std::as_bytes(std::span(kLine.data(), kLine.size()));
  const int refused =
      parse_mutations({bytes.begin(), bytes.end()}, 20000, 26, [](std::span<const std::byte> mutated) {
        parse_released_record({reinterpret_cast<const char*>(mutated.data()), mutated.size()}, "a.csv:1");
      });
  CHECK(refused > 5000);
}

TEST_CASE("damage in a released scene is named", "[released]") {
  const TempFolder folder;
  write_released_set(folder.path());
  const auto refusal = [&] {
    return message_of([&] { open_dataset(folder.path())->load(Split::kTrain, 0); });
  };
  SECTION("missing angle") {
    fs::remove(folder / "train/7/90.png");
    CHECK(contains(refusal(), "90 degrees is missing"));
  }
  SECTION("missing pure-BSDF angle") {
    fs::remove(folder / "train/7/135_BSDF.png");
    CHECK(contains(refusal(), "135_BSDF.png"));
  }
  SECTION("other depth shape") {
    write_npy(folder / "train/7/depth.npy", std::vector<float>(16), std::vector<int64_t>{4, 4});
    CHECK(contains(refusal(), "depth.npy"));
  }
  SECTION("few coefficients") {
    write_npy(folder / "train/7/coeffs.npy", std::vector<float>(12), std::vector<int64_t>{4, 3});
    CHECK(contains(refusal(), "coeffs.npy"));
  }
  SECTION("scene twice") {
    write_text(folder / "train.csv", kLine + "\n" + kLine + "\n");
    CHECK(contains(refusal(), "train.csv:2"));
  }
  SECTION("no folder") {
    fs::rename(folder / "train/7", folder / "train/9");
    CHECK(contains(refusal(), "scene 7 of the index has no folder"));
  }
}

void write_capture(const fs::path& folder, float gain45) {
  fs::create_directories(folder);
  write_polarisers(folder, moderate_light(), "p", "", gain45);
  write_png(folder / "mask.png", kSize, kSize, 1, disc_mask());
}

TEST_CASE("a capture's pairs are equalised by their median ratio", "[capture]") {
  const TempFolder folder;
  write_capture(folder / "3", 1.1F);
  const Scene scene = read_capture(folder / "3");
  REQUIRE(scene.pair_ratio.has_value());
  CHECK(std::abs(*scene.pair_ratio - 1.1F) < 0.005F);
  const std::vector<float> expected = moderate_light();
  // Both pairs end at their mean: 1.05 times the light.
  for (size_t i = 0; i < expected.size(); i += 9) {
    REQUIRE(std::abs(scene.image[i] / (1.05F * expected[i]) - 1) < 0.02F);
    REQUIRE(std::abs(scene.image[i + 3] - 1.05F * expected[i + 3]) < 0.03F);
    REQUIRE(std::abs(scene.image[i + 6] - 1.05F * expected[i + 6]) < 0.03F);
  }
  // A mask value between 0 and 255 is not the object.
  CHECK(std::count(scene.mask.begin(), scene.mask.end(), 1) == [] {
    const auto m = disc_mask();
    return std::count(m.begin(), m.end(), 255);
  }());
}

TEST_CASE("Stokes files of a capture give its light in our signs", "[capture]") {
  const TempFolder folder;
  write_capture(folder / "3", 1.0F);
  const std::vector<float> light = moderate_light();
  for (const size_t k : {0U, 1U, 2U}) {
    std::vector<float> values;
    for (size_t i = 0; i < light.size(); i += 9) {
      for (size_t c = 0; c < 3; ++c) values.push_back((k == 1 ? -1.0F : 1.0F) * light[i + 3 * k + c]);
    }
    write_npy(folder / ("3/s" + std::to_string(k) + ".npy"), values, std::vector<int64_t>{kSize, kSize, 3});
  }
  const Scene scene = read_capture(folder / "3");
  for (size_t i = 0; i < light.size(); ++i) REQUIRE(std::abs(scene.image[i] - light[i]) < 2e-3F);
  // Files of another image are refused.
  std::vector<float> noise;
  Random random(5, Purpose::kTest);
  for (int i = 0; i < kSize * kSize * 3; ++i) noise.push_back(random.uniform_float() - 0.5F);
  write_npy(folder / "3/s2.npy", noise, std::vector<int64_t>{kSize, kSize, 3});
  CHECK(contains(message_of([&] { read_capture(folder / "3"); }), "s2.npy"));
}

TEST_CASE("faults of a capture are named", "[capture]") {
  const TempFolder folder;
  write_capture(folder / "3", 1.0F);
  const auto refusal = [&] { return message_of([&] { read_capture(folder / "3"); }); };
  SECTION("missing angle") {
    fs::remove(folder / "3/p45.png");
    CHECK(contains(refusal(), "45 degrees is missing"));
    CHECK(contains(refusal(), "p45.png"));
  }
  SECTION("first angle missing, found by the others") {
    fs::remove(folder / "3/p0.png");
    CHECK(contains(message_of([&] { open_dataset(folder.path())->load(Split::kTest, 0); }), "p0.png"));
  }
  SECTION("other size") {
    write_png(folder / "3/p90.png", 16, 16, 3, std::vector<uint8_t>(16 * 16 * 3));
    CHECK(contains(refusal(), "16 x 16"));
  }
  SECTION("grey") {
    write_png(folder / "3/p90.png", kSize, kSize, 1, std::vector<uint8_t>(kSize * kSize));
    CHECK(contains(refusal(), "is grey"));
  }
  SECTION("no mask") {
    fs::remove(folder / "3/mask.png");
    CHECK(contains(refusal(), "mask.png is missing"));
  }
  SECTION("empty mask") {
    write_png(folder / "3/mask.png", kSize, kSize, 1, std::vector<uint8_t>(kSize * kSize, 254));
    CHECK(contains(refusal(), "marks no object"));
  }
}

TEST_CASE("captures are listed in the order of their numbers", "[capture]") {
  const TempFolder folder;
  for (const char* name : {"10", "9", "b"}) write_capture(folder / name, 1.0F);
  fs::create_directories(folder / "empty");
  const auto set = open_dataset(folder.path());
  REQUIRE(set->size(Split::kTest) == 3);
  CHECK(set->size(Split::kTrain) == 0);
  CHECK(set->id(Split::kTest, 0) == "9");
  CHECK(set->id(Split::kTest, 1) == "10");
  CHECK(set->id(Split::kTest, 2) == "b");
  const auto one = open_dataset(folder.path() / "9" / "");
  REQUIRE(one->size(Split::kTest) == 1);
  CHECK(one->load(Split::kTest, 0).id == "9");
}

TEST_CASE("the real captures read as their authors describe them", "[capture][real]") {
  const fs::path root = fs::path(OPALINE_SOURCE_DIR) / "../shared/real_captures";
  if (!fs::exists(root)) {
    WARN("skipped: no real captures at " << root.string());
    return;
  }
  const auto set = open_dataset(root);
  CHECK(set->facts().layout == "capture");
  CHECK(set->facts().width == 256);
  REQUIRE(set->size(Split::kTest) == 2);
  for (int64_t index = 0; index < 2; ++index) {
    const Scene scene = set->load(Split::kTest, index);
    const fs::path folder = root / scene.id;
    INFO("capture " << scene.id);
    // I45 + I135 exceeds I0 + I90 by 2 to 3 %.
    CHECK(*scene.pair_ratio > 1.015F);
    CHECK(*scene.pair_ratio < 1.035F);

    // s0 from the PNGs, without and with the half level that truncation took away.
    const PolariserImages images = read_polariser_images(folder, "p");
    const std::vector<float> from_png = equalised_stokes(images, 1.0F);
    const NpyArray s0 = read_npy(folder / "s0.npy");
    double error = 0;
    double total = 0;
    for (size_t i = 0; i < s0.values.size(); ++i) {
      if (scene.mask[i / 3] == 0) continue;
      error += std::abs(static_cast<double>(from_png[i / 3 * 9 + i % 3]) - s0.values[i]);
      total += s0.values[i];
    }
    CHECK(error / total < 5e-3);

    // Just inside the silhouette the polarisation follows the normal's azimuth (light from within, capture 0)
    // or its perpendicular (reflection, capture 4): the parts of S1 and of S2 must agree on which.
    double along1 = 0;
    double along2 = 0;
    double weight1 = 0;
    double weight2 = 0;
    const auto at = [&](int x, int y) { return scene.mask[static_cast<size_t>(y * 256 + x)] != 0; };
    for (int y = 4; y < 252; ++y) {
      for (int x = 4; x < 252; ++x) {
        if (!at(x, y)) continue;
        // The mask's gradient over a small window: towards the outside, y up.
        double nx = 0;
        double ny = 0;
        for (int dy = -4; dy <= 4; ++dy) {
          for (int dx = -4; dx <= 4; ++dx) {
            if (at(std::clamp(x + dx, 0, 255), std::clamp(y + dy, 0, 255))) continue;
            nx += dx;
            ny -= dy;
          }
        }
        const double length2 = nx * nx + ny * ny;
        if (length2 < 100) continue;
        const float* s = scene.image.data() + static_cast<size_t>(y * 256 + x) * 9;
        for (int c = 0; c < 3; ++c) {
          const double light = static_cast<double>(s[c]);
          const double part1 = static_cast<double>(s[3 + c]) / light * (nx * nx - ny * ny) / length2;
          const double part2 = static_cast<double>(s[6 + c]) / light * 2 * nx * ny / length2;
          along1 += part1;
          along2 += part2;
          weight1 += std::abs(part1);
          weight2 += std::abs(part2);
        }
      }
    }
    INFO("along the silhouette's normal: " << along1 / weight1 << " by S1, " << along2 / weight2 << " by S2");
    const double sign = scene.id == "0" ? 1 : -1;
    CHECK(sign * along1 / weight1 > 0.3);
    CHECK(sign * along2 / weight2 > 0.3);
  }
}

}  // namespace
}  // namespace opaline::test
