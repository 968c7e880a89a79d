// The checks of data sets: each sees what it is there for, by breaking that.
#include "data/check.h"

#include <nlohmann/json.hpp>

#include "core/parallel.h"
#include "data/check_page.h"
#include "data/encode.h"
#include "data/npy.h"
#include "data/png.h"
#include "tests/data/support.h"
#include "tests/train/synthetic.h"

namespace opaline::test {
namespace {

namespace fs = std::filesystem;

constexpr int kSide = 64;

/// A sphere whose light has scattered and is polarised as it leaves, brighter than it is there; the pure-BSDF
/// image is dark. Several differ in place, size and light.
SceneImages polarised_images(int number) {
  const SyntheticDataset dataset({.train = 16, .test = 0, .size = kSide});
  const Scene scene = dataset.load(Split::kTrain, number, {});
  SceneImages images{.width = kSide, .height = kSide};
  images.image = scene.image;
  images.bsdf.assign(scene.image.size(), 0.0F);
  images.normal = scene.normal;
  images.depth = scene.depth;
  images.coverage.assign(scene.mask.begin(), scene.mask.end());
  return images;
}

using Change = std::function<void(SceneImages&)>;

/// Changes S1 and S2 of every pixel.
Change on_polarisation(const std::function<void(float& s1, float& s2)>& change) {
  return [change](SceneImages& images) {
    for (size_t i = 0; i < images.image.size(); i += 9) {
      for (size_t c = 0; c < 3; ++c) change(images.image[i + 3 + c], images.image[i + 6 + c]);
    }
  };
}

/// A set of ours: `train` spheres, the last of which is the test scene.
void write_spheres(
    const fs::path& root, int count, const Change& change = [](SceneImages&) {}) {
  std::vector<SceneRecord> records;
  for (int i = 0; i < count; ++i) {
    SceneImages images = polarised_images(i);
    change(images);
    records.push_back(small_record(std::to_string(i), static_cast<uint32_t>(i)));
    write_scene(root, i, images, records.back());
  }
  write_scene_index(root / "train.jsonl", {records.begin(), records.end() - 1});
  write_scene_index(root / "test.jsonl", {records.back()});
  write_scene_set_info(
      root, {.generator_version = "1", .train = count - 1, .test = 1, .width = kSide, .height = kSide});
}

DatasetCheck check(const fs::path& root) {
  return check_dataset(*open_dataset(root));
}

DatasetCheck check_changed(const Change& change) {
  const TempFolder folder;
  write_spheres(folder.path(), 4, change);
  return check(folder.path());
}

/// How a capture's files are written.
struct CaptureOptions {
  double gamma = 2.2;
  std::array<size_t, 4> order = {0, 1, 2, 3};  ///< which image stands in the place of 0, 45, 90, 135 degrees
  float gain45 = 1.0F;                         ///< of the images at 45 and 135 degrees
  bool stokes = false;                         ///< s0.npy .. beside them, with s1 = I90 - I0
};

void write_capture(const fs::path& folder, int number, const CaptureOptions& options) {
  fs::create_directories(folder);
  SceneImages scene = polarised_images(number);
  for (float& value : scene.image) value *= 2.0F;
  const std::vector<float> light = polariser_images(scene.image);
  const std::array<const char*, 4> names = {"p0.png", "p45.png", "p90.png", "p135.png"};
  for (size_t k = 0; k < 4; ++k) {
    const size_t angle = options.order[k];
    std::vector<uint8_t> bytes;
    for (size_t i = 0; i < light.size() / 12; ++i) {
      for (size_t c = 0; c < 3; ++c) {
        const float value = (angle % 2 == 1 ? options.gain45 : 1.0F) * light[12 * i + 3 * angle + c];
        bytes.push_back(static_cast<uint8_t>(
            255.0 * std::pow(std::clamp(static_cast<double>(value), 0.0, 1.0), 1.0 / options.gamma)));
      }
    }
    write_png(folder / names[k], kSide, kSide, 3, bytes);
  }
  std::vector<uint8_t> mask;
  for (const float a : scene.coverage) mask.push_back(a > 0.0F ? 255 : 0);
  write_png(folder / "mask.png", kSide, kSide, 1, mask);
  if (!options.stokes) return;
  for (size_t s = 0; s < 3; ++s) {
    std::vector<float> values;
    for (size_t i = 0; i < scene.image.size(); i += 9) {
      for (size_t c = 0; c < 3; ++c) values.push_back((s == 1 ? -1.0F : 1.0F) * scene.image[i + 3 * s + c]);
    }
    write_npy(folder / fmt::format("s{}.npy", s), values, std::vector<int64_t>{kSide, kSide, 3});
  }
}

DatasetCheck check_captures(const CaptureOptions& options) {
  const TempFolder folder;
  for (int i = 0; i < 4; ++i) write_capture(folder / std::to_string(i), i, options);
  return check(folder.path());
}

const Finding& finding(const DatasetCheck& check, std::string_view what) {
  for (const Finding& f : check.findings) {
    if (f.what == what) return f;
  }
  FAIL("no finding '" << what << "' in\n" << to_text(check));
  return check.findings.front();
}

TEST_CASE("a sound set is found sound and in our conventions", "[check]") {
  const TempFolder folder;
  write_spheres(folder.path(), 5);
  const DatasetCheck found = check(folder.path());
  const std::string text = to_text(found);
  INFO(text);
  CHECK(found.sound());
  CHECK(found.frame.ours());
  CHECK(found.frame.slope > 0.9);
  CHECK(found.frame.silhouette > 0.9);
  CHECK(found.signs.known);
  CHECK(found.signs.polarity);
  CHECK(found.signs.agrees());
  REQUIRE(found.splits.size() == 2);
  CHECK(found.splits[0].scenes.size() == 4);
  for (const Finding& f : found.findings) CHECK(f.verdict == Verdict::kGood);
  CHECK(contains(text, "train: 4 scenes, 4 usable"));
  CHECK(contains(text, "x right, y up, z towards the camera, larger depth is nearer"));
  CHECK(contains(text, "0 problems, 0 warnings"));
}

TEST_CASE("every flip of the frame is named", "[check]") {
  for (unsigned flips = 0; flips < 16; ++flips) {
    const DatasetCheck found = check_changed([flips](SceneImages& images) {
      for (size_t i = 0; i < images.depth.size(); ++i) {
        if ((flips & 1U) != 0) images.normal[3 * i] *= -1;
        if ((flips & 2U) != 0) images.normal[3 * i + 1] *= -1;
        if ((flips & 4U) != 0) images.normal[3 * i + 2] *= -1;
        if ((flips & 8U) != 0) images.depth[i] *= -1;
      }
    });
    INFO(to_text(found));
    REQUIRE(found.frame.known);
    CHECK(found.frame.flip_x == ((flips & 1U) != 0));
    CHECK(found.frame.flip_y == ((flips & 2U) != 0));
    CHECK(found.frame.flip_z == ((flips & 4U) != 0));
    CHECK(found.frame.flip_depth == ((flips & 8U) != 0));
    CHECK(found.sound() == (flips == 0));  // ours promises a frame
    CHECK(found.signs.agrees());           // whatever the normals' frame
  }
}

TEST_CASE("one scene in another frame than the others is named", "[check]") {
  const TempFolder folder;
  write_spheres(folder.path(), 5);
  SceneImages images = polarised_images(1);
  for (size_t i = 0; i < images.depth.size(); ++i) images.normal[3 * i + 1] *= -1;
  std::vector<SceneRecord> records = read_scene_index(folder / "train.jsonl");
  write_scene(folder.path(), 1, images, records[1]);
  write_scene_index(folder / "train.jsonl", records);
  const DatasetCheck found = check(folder.path());
  CHECK(found.problem_count() == 1);
  REQUIRE(found.splits[0].scenes[1].problems.size() == 1);
  CHECK(contains(found.splits[0].scenes[1].problems[0], "y down"));
}

TEST_CASE("wrong signs of s1 and s2 are named", "[check]") {
  const DatasetCheck s1 = check_changed(on_polarisation([](float& a, float&) { a = -a; }));
  CHECK_FALSE(s1.sound());
  CHECK(contains(finding(s1, "signs of s1 and s2").found, "s1 has the wrong sign"));
  const DatasetCheck s2 = check_changed(on_polarisation([](float&, float& b) { b = -b; }));
  CHECK_FALSE(s2.sound());
  CHECK(contains(finding(s2, "signs of s1 and s2").found, "s2 has the wrong sign"));
  const DatasetCheck both = check_changed(on_polarisation([](float& a, float& b) {
    a = -a;
    b = -b;
  }));
  CHECK_FALSE(both.sound());
  CHECK(contains(finding(both, "signs of s1 and s2").found, "s1 and s2 both have the wrong sign"));
  const DatasetCheck turned = check_changed(on_polarisation([](float& a, float& b) {
    std::swap(a, b);
    b = -b;
  }));
  CHECK_FALSE(turned.sound());
  CHECK(contains(finding(turned, "signs of s1 and s2").found, "off by 45 degrees"));
  // Light without polarisation tells nothing, which is no problem.
  const DatasetCheck none = check_changed(on_polarisation([](float& a, float& b) { a = b = 0; }));
  CHECK(none.sound());
  CHECK(finding(none, "signs of s1 and s2").verdict == Verdict::kUndecided);
}

TEST_CASE("a declared sign that is not the files' is seen, one that is is not", "[check]") {
  const auto declare = [](const fs::path& root) {
    std::string text = read_text(root / "dataset.toml");
    const size_t at = text.find("I0 - I90");
    REQUIRE(at != std::string::npos);
    write_file_atomically(root / "dataset.toml", text.replace(at, 8, "I90 - I0"));
  };
  const TempFolder right, wrong;
  write_spheres(right.path(), 4, on_polarisation([](float& a, float&) { a = -a; }));
  declare(right.path());
  CHECK(check(right.path()).sound());
  write_spheres(wrong.path(), 4);
  declare(wrong.path());
  const DatasetCheck found = check(wrong.path());
  CHECK_FALSE(found.sound());
  CHECK(found.signs.flip_1);
  CHECK_FALSE(found.signs.flip_2);
}

TEST_CASE("damage is counted and named", "[check]") {
  const TempFolder folder;
  write_small_set(folder.path(), 4, 0);
  std::vector<std::byte> bytes = read_file(folder / "scenes/000001.exr");
  bytes.resize(bytes.size() - 7);
  write_file_atomically(folder / "scenes/000001.exr", bytes);
  bytes = read_file(folder / "scenes/000002.exr");
  bytes[bytes.size() / 2] ^= std::byte{16};
  write_file_atomically(folder / "scenes/000002.exr", bytes);
  fs::copy_file(folder / "scenes/000000.exr", folder / "scenes/000099.exr");
  fs::remove(folder / "scenes/000003.exr");
  write_scene_set_info(folder.path(), {.train = 5, .test = 0, .width = 32, .height = 32});
  const DatasetCheck found = check(folder.path());
  CHECK_FALSE(found.sound());
  const std::string text = to_text(found);
  INFO(text);
  CHECK(contains(text, "promises 5 train scenes, train.jsonl lists 4"));
  for (const char* name : {"000001.exr", "000002.exr", "000003.exr"}) CHECK(contains(text, name));
  CHECK(contains(text, "scenes/ has 1 files that no index lists"));
  CHECK(contains(text, "4 problems, 1 warnings"));
  CHECK(finding(found, "files").found == "1 of 4");
  CHECK(finding(found, "index").verdict == Verdict::kBad);
  CHECK_FALSE(contains(to_text(found, 0), "000001.exr"));
}

TEST_CASE("the same scene twice is seen, whatever it is called", "[check]") {
  const TempFolder folder;
  write_small_set(folder.path(), 3, 1);
  std::vector<SceneRecord> records = read_scene_index(folder / "train.jsonl");
  fs::remove(folder / "scenes/000002.exr");
  records[2].object = "another";
  write_scene(folder.path(), 2, small_images(32, 32, 0), records[2]);
  write_scene_index(folder / "train.jsonl", records);
  const DatasetCheck found = check(folder.path());
  CHECK(found.problem_count() == 1);
  CHECK(contains(to_text(found), "train scene 2 has the light of train scene 0"));
  CHECK(finding(found, "each scene once").verdict == Verdict::kBad);
  // One file under two ids.
  records[2] = records[0];
  records[2].id = "2";
  write_scene_index(folder / "train.jsonl", records);
  CHECK(contains(to_text(check(folder.path())), "scenes/000000.exr is listed more than once"));
  // One id twice does not even open.
  records[2].id = "0";
  write_scene_index(folder / "train.jsonl", records);
  CHECK(contains(message_of([&] { check(folder.path()); }), "lists scene 0 twice"));
}

TEST_CASE("an index that does not fit its files is seen", "[check]") {
  const TempFolder folder;
  write_small_set(folder.path(), 3, 0);
  std::vector<SceneRecord> records = read_scene_index(folder / "train.jsonl");
  records[0].box.x0 += 4;
  records[1].coverage *= 0.5;
  write_scene_index(folder / "train.jsonl", records);
  const DatasetCheck found = check(folder.path());
  CHECK(found.problem_count() == 2);
  CHECK(contains(found.splits[0].scenes[0].problems.at(0), "its mask reaches over"));
  CHECK(contains(found.splits[0].scenes[1].problems.at(0), "the index says it covers"));
}

TEST_CASE("an object of both splits is seen", "[check]") {
  const TempFolder folder;
  write_small_set(folder.path(), 3, 1);
  std::vector<SceneRecord> records = read_scene_index(folder / "test.jsonl");
  records[0].object = "sphere-1";
  write_scene_index(folder / "test.jsonl", records);
  const DatasetCheck found = check(folder.path());
  CHECK_FALSE(found.sound());
  CHECK(contains(finding(found, "objects of the splits").found, "sphere-1"));
  CHECK(finding(found, "environments of the splits").verdict == Verdict::kGood);
  // Sets of other makers never promised that they are disjoint.
  write_scene_set_info(folder.path(), {.generator = "x", .train = 3, .test = 1, .width = 32, .height = 32});
  CHECK(check(folder.path()).sound());
  CHECK(check(folder.path()).warning_count() == 1);
}

TEST_CASE("odd scenes are warned about", "[check]") {
  const TempFolder folder;
  SceneImages images = small_images(32, 32);
  std::fill(images.coverage.begin(), images.coverage.end(), 0.0F);
  SceneRecord record = small_record("0");
  record.g = 0.95;
  write_scene(folder.path(), 0, images, record);
  write_scene_index(folder / "test.jsonl", {record});
  write_scene_set_info(folder.path(), {.test = 1, .width = 32, .height = 32});
  const DatasetCheck found = check(folder.path());
  const std::string text = to_text(found);
  INFO(text);
  CHECK(contains(text, "the mask is empty"));
  CHECK(contains(text, "g is 0.95"));
  CHECK(finding(found, "mask").verdict == Verdict::kWarning);
  CHECK(finding(found, "parameters").verdict == Verdict::kWarning);
}

TEST_CASE("light and depth that cannot be are problems of our sets", "[check]") {
  const DatasetCheck over = check_changed(on_polarisation([](float& a, float&) { a = 1.9F; }));
  CHECK_FALSE(over.sound());
  CHECK(contains(to_text(over), "have a degree of polarisation over 1"));
  const DatasetCheck deep = check_changed([](SceneImages& images) {
    for (float& z : images.depth) z *= 8;
  });
  CHECK_FALSE(deep.sound());
  CHECK(contains(to_text(deep), "the cube that objects stay in"));
}

TEST_CASE("captures: what is right is found right", "[check]") {
  const DatasetCheck found = check_captures({.stokes = true});
  const std::string text = to_text(found);
  INFO(text);
  CHECK(found.sound());
  CHECK(finding(found, "angles of the images").verdict == Verdict::kGood);
  CHECK(finding(found, "gamma").verdict == Verdict::kGood);
  CHECK(finding(found, "signs of s1 and s2").verdict == Verdict::kGood);
  CHECK(contains(finding(found, "stored s1.npy, s2.npy").found, "s1 = -(p0 - p90), s2 = +(p45 - p135)"));
  REQUIRE(found.gamma.known);
  CHECK(std::abs(found.gamma.gamma - 2.2) < 0.15);
  REQUIRE(found.gamma.by_stokes.has_value());
  CHECK(std::abs(*found.gamma.by_stokes - 2.2) < 0.03);
  for (const SceneCheck& scene : found.splits[0].scenes) {
    REQUIRE(scene.pairs.has_value());
    CHECK(std::abs(scene.pairs->ratio - 1) < 0.01);
    CHECK(scene.pairs->rms < 0.05);
  }
}

TEST_CASE("captures: a wrong gamma is measured", "[check]") {
  for (const double gamma : {1.0, 1.6}) {
    const DatasetCheck found = check_captures({.gamma = gamma});
    INFO(to_text(found));
    REQUIRE(found.gamma.known);
    CHECK(std::abs(found.gamma.gamma - gamma) < 0.15);
    CHECK_FALSE(found.sound());
    const DatasetCheck by_stokes = check_captures({.gamma = gamma, .stokes = true});
    CHECK(std::abs(by_stokes.gamma.by_stokes.value() - gamma) < 0.05);
  }
}

TEST_CASE("captures: swapped and shifted images are named", "[check]") {
  const DatasetCheck pairs = check_captures({.order = {1, 0, 2, 3}});
  CHECK_FALSE(pairs.sound());
  CHECK(contains(finding(pairs, "angles of the images").found, "0 with 135, 45 with 90"));
  for (const std::array<size_t, 4>& order : {std::array<size_t, 4>{2, 1, 0, 3}, {0, 3, 2, 1}}) {
    const DatasetCheck mirrored = check_captures({.order = order});
    CHECK_FALSE(mirrored.sound());
    CHECK(contains(finding(mirrored, "signs of s1 and s2").found, "s1 or s2 has the wrong sign"));
  }
  const DatasetCheck turned = check_captures({.order = {1, 2, 3, 0}});
  CHECK_FALSE(turned.sound());
  CHECK(contains(finding(turned, "signs of s1 and s2").found, "off by 45 degrees"));
}

TEST_CASE("captures: pairs that differ by over five per cent fail", "[check]") {
  const DatasetCheck small = check_captures({.gain45 = 1.03F});
  CHECK(small.sound());
  CHECK(std::abs(small.splits[0].scenes[0].pairs->ratio - 1.03) < 0.005);
  const DatasetCheck large = check_captures({.gain45 = 1.06F});
  CHECK(large.problem_count() == 4);
  CHECK(contains(to_text(large), "1.06"));
  CHECK(finding(large, "I0 + I90 = I45 + I135").verdict == Verdict::kBad);
}

/// A scene in the layout of the released synthetic set, with normals whose y points down.
void write_released_scene(const fs::path& folder, int number) {
  write_capture(folder, number, {});
  for (const char* angle : {"0", "45", "90", "135"}) {
    fs::rename(folder / fmt::format("p{}.png", angle), folder / fmt::format("{}.png", angle));
    fs::copy_file(folder / fmt::format("{}.png", angle), folder / fmt::format("{}_BSDF.png", angle));
  }
  const SceneImages scene = polarised_images(number);
  std::vector<uint8_t> normals;
  for (size_t i = 0; i < scene.normal.size(); ++i) {
    const float n = i % 3 == 1 ? -scene.normal[i] : scene.normal[i];
    normals.push_back(static_cast<uint8_t>(std::lround(127.5F * (n + 1.0F))));
  }
  write_png(folder / "normal.png", kSide, kSide, 3, normals);
  write_npy(folder / "depth.npy", scene.depth, std::vector<int64_t>{kSide, kSide});
  write_npy(folder / "coeffs.npy", std::vector<float>(27, 0.5F), std::vector<int64_t>{9, 3});
}

TEST_CASE("the released layout is checked, and its undocumented frame named", "[check]") {
  const TempFolder folder;
  std::string csv;
  for (int i = 0; i < 4; ++i) {
    write_released_scene(folder / fmt::format("train/{}", i), i);
    csv += fmt::format("{};obj;env;bump;50;0.5,0.25,1;0.4,0.5,0.6;0.3;1;0;0;0;0;0;0;0;90;0;1\n", i);
  }
  write_file_atomically(folder / "train.csv", csv);
  const DatasetCheck found = check(folder.path());
  const std::string text = to_text(found);
  INFO(text);
  CHECK(found.sound());
  CHECK(finding(found, "normals and depth").verdict == Verdict::kWarning);
  CHECK(contains(text, "x right, y down, z towards the camera, larger depth is nearer"));
  CHECK(finding(found, "gamma").verdict == Verdict::kGood);
  CHECK(finding(found, "angles of the images").verdict == Verdict::kGood);
  CHECK(finding(found, "signs of s1 and s2").verdict == Verdict::kGood);
  REQUIRE(found.splits.size() == 1);
  CHECK(found.splits[0].scenes[0].parameters.size() == 8);
  // A file that is missing is the scene's problem, named.
  fs::remove(folder / "train/2/depth.npy");
  const DatasetCheck damaged = check(folder.path());
  CHECK(damaged.problem_count() == 1);
  CHECK(contains(to_text(damaged), "train/2/depth.npy"));
}

TEST_CASE("captures: the authors' are what is known of them", "[check][real]") {
  const fs::path root = fs::path(OPALINE_SOURCE_DIR) / "../shared/real_captures";
  if (!fs::exists(root)) {
    WARN("skipped: no real captures at " << root.string());
    return;
  }
  const DatasetCheck found = check(root);
  INFO(to_text(found));
  CHECK(found.sound());
  // 8 bits, gamma 2.2, truncated; the pairs differ by 2 to 3 %; s1 is stored as p0 - p90.
  CHECK(finding(found, "angles of the images").verdict == Verdict::kGood);
  CHECK(finding(found, "signs of s1 and s2").verdict == Verdict::kGood);
  CHECK(contains(finding(found, "stored s1.npy, s2.npy").found, "s1 = +(p0 - p90), s2 = +(p45 - p135)"));
  CHECK(found.gamma.known);
  CHECK(std::abs(found.gamma.gamma - 2.2) < 0.1);
  CHECK(std::abs(found.gamma.by_stokes.value() - 2.2) < 0.02);
  for (const SceneCheck& scene : found.splits[0].scenes) {
    CHECK(scene.pairs->ratio > 1.02);
    CHECK(scene.pairs->ratio < 1.03);
    CHECK(scene.pairs->rms < 0.06);
    CHECK(scene.pairs->saturated < 0.01);
  }
}

TEST_CASE("the page and the JSON hold what was found", "[check]") {
  const TempFolder folder;
  write_spheres(folder.path(), 4);
  fs::remove(folder / "scenes/000001.exr");
  const auto set = open_dataset(folder.path());
  const DatasetCheck found = check_dataset(*set);
  const std::string page = check_page(found, *set);
  CHECK(contains(page, "</html>"));
  CHECK(contains(page, "data:image/png;base64,"));
  CHECK(contains(page, "sigma_t R"));
  CHECK(contains(page, "000001.exr"));
  CHECK(contains(page, "cannot be read"));
  CHECK_FALSE(contains(page, "http://"));
  const nlohmann::json json = nlohmann::json::parse(to_json(found));
  CHECK(json["sound"] == false);
  CHECK(json["splits"]["train"].size() == 3);
  CHECK(json["splits"]["train"][1]["problems"].size() == 1);
  CHECK(json["splits"]["test"][0]["parameters"].size() == 8);
  CHECK(json["findings"].size() == found.findings.size());
}

TEST_CASE("the findings do not depend on the number of threads", "[check]") {
  const TempFolder folder;
  write_spheres(folder.path(), 5);
  const std::string many = to_json(check(folder.path()));
  const ThreadsGuard one(1);
  CHECK(to_json(check(folder.path())) == many);
}

}  // namespace
}  // namespace opaline::test
