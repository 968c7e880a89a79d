#include "data/scene_set.h"

#include <fstream>

#include "data/dataset.h"
#include "tests/data/support.h"

namespace opaline::test {
namespace {

namespace fs = std::filesystem;

void replace_in_file(const fs::path& path, const std::string& from, const std::string& to) {
  std::string text = read_text(path);
  const size_t at = text.find(from);
  REQUIRE(at != std::string::npos);
  text.replace(at, from.size(), to);
  write_file_atomically(path, text);
}

TEST_CASE("a scene record survives its line", "[scene_set]") {
  SceneRecord record = small_record("17");
  record.file = "scenes/000017.exr";
  record.xxh64 = "0123456789abcdef";
  record.box = {3, 4, 20, 30};
  record.coverage = 0.25;
  const std::string line = to_json_line(record);
  CHECK(line.find('\n') == std::string::npos);
  const SceneRecord back = parse_scene_record(line, "train.jsonl:1");
  CHECK(to_json_line(back) == line);
  CHECK(back.box == record.box);
  CHECK(back.seed == record.seed);
  CHECK(back.sh == record.sh);
}

TEST_CASE("a bad line of the index is refused with file, line and key", "[scene_set]") {
  SceneRecord record = small_record("17");
  record.file = "scenes/000017.exr";
  record.xxh64 = "0123456789abcdef";
  record.box = {3, 4, 20, 30};
  const std::string good = to_json_line(record);
  const auto refusal = [&](const std::string& from, const std::string& to) {
    std::string line = good;
    const size_t at = line.find(from);
    REQUIRE(at != std::string::npos);
    line.replace(at, from.size(), to);
    const std::string message = message_of([&] { parse_scene_record(line, "train.jsonl:5"); });
    CHECK(contains(message, "train.jsonl:5"));
    return message;
  };
  CHECK(contains(refusal("\"albedo\"", "\"albedos\""), "'albedo' is missing"));
  CHECK(contains(refusal("scenes/000017.exr", "../../secret"), "inside the data set"));
  CHECK(contains(refusal("scenes/000017.exr", "/etc/passwd"), "inside the data set"));
  CHECK(contains(refusal("[3,4,20,30]", "[3,4,3,30]"), "'box' is empty"));
  CHECK(contains(refusal("[3,4,20,30]", "[3,4,20]"), "'box' must hold 4 numbers"));
  CHECK(contains(refusal("\"spp\":16", "\"spp\":1.5"), "'spp'"));
  CHECK(contains(refusal("\"coverage\":0.0", "\"coverage\":7"), "'coverage' is 7"));
  CHECK(contains(refusal("\"seconds\":0.25", "\"seconds\":null"), "'seconds' must be a number"));
  CHECK(contains(refusal("}", ""), "is not JSON"));
}

TEST_CASE("damaged index lines are parsed or refused, never more", "[scene_set][fuzz]") {
  SceneRecord record = small_record("17");
  record.file = "scenes/000017.exr";
  record.xxh64 = "0123456789abcdef";
  record.box = {3, 4, 20, 30};
  const std::string line = to_json_line(record);
  const auto bytes = std::as_bytes(std::span(line.data(), line.size()));
  const int refused =
      parse_mutations({bytes.begin(), bytes.end()}, 10000, 25, [](std::span<const std::byte> mutated) {
        parse_scene_record({reinterpret_cast<const char*>(mutated.data()), mutated.size()}, "train.jsonl:1");
      });
  CHECK(refused > 5000);
}

TEST_CASE("a torn last line is dropped only where that was asked for", "[scene_set]") {
  const TempFolder folder;
  SceneRecord record = small_record("0");
  record.file = "scenes/000000.exr";
  record.xxh64 = "0123456789abcdef";
  record.box = {0, 0, 1, 1};
  append_scene_record(folder / "train.jsonl", record);
  record.id = "1";
  append_scene_record(folder / "train.jsonl", record);
  CHECK(read_scene_index(folder / "train.jsonl").size() == 2);
  std::ofstream(folder / "train.jsonl", std::ios::app) << "{\"id\": \"2\", \"fi";
  CHECK(read_scene_index(folder / "train.jsonl", true).size() == 2);
  CHECK(contains(message_of([&] { read_scene_index(folder / "train.jsonl"); }), "train.jsonl:3"));
}

TEST_CASE("a written scene comes back within half precision", "[scene_set]") {
  const TempFolder folder;
  write_small_set(folder.path(), 2, 1);
  const auto set = open_dataset(folder.path());
  CHECK(set->facts().layout == "opaline");
  CHECK(set->facts().width == 32);
  CHECK(set->size(Split::kTrain) == 2);
  REQUIRE(set->size(Split::kTest) == 1);
  const SceneImages expected = small_images(32, 32, 2);
  const SceneRecord record = small_record("2", 2);
  const Scene scene = set->load(Split::kTest, 0);
  CHECK(scene.id == "2");
  CHECK_FALSE(scene.pair_ratio.has_value());
  const auto near = [](float a, float b) { return std::abs(a - b) <= 1e-3F * std::max(1.0F, std::abs(b)); };
  const auto all_near = [&](const std::vector<float>& a, const std::vector<float>& b) {
    return a.size() == b.size() && std::equal(a.begin(), a.end(), b.begin(), near);
  };
  CHECK(all_near(scene.image, expected.image));
  CHECK(all_near(scene.bsdf, expected.bsdf));
  for (size_t i = 0; i < expected.coverage.size(); ++i) {
    const bool object = expected.coverage[i] == 1.0F;
    REQUIRE(scene.mask[i] == (object ? 1 : 0));
    for (size_t c = 0; c < 3; ++c) {
      REQUIRE(near(scene.normal[3 * i + c], object ? expected.normal[3 * i + c] : 0.0F));
    }
    REQUIRE(near(scene.depth[i], object ? expected.depth[i] : 0.0F));
  }
  CHECK(near(*scene.g, static_cast<float>(record.g)));
  CHECK(near(*scene.flash, static_cast<float>(record.flash)));
  CHECK(near((*scene.sigma_t)[2], static_cast<float>(record.sigma_t[2])));
  CHECK(near((*scene.albedo)[1], static_cast<float>(record.albedo[1])));
  CHECK(near((*scene.sh)[26], static_cast<float>(record.sh[26])));
}

TEST_CASE("what is not asked for is not loaded", "[scene_set]") {
  const TempFolder folder;
  write_small_set(folder.path(), 1, 0);
  const auto set = open_dataset(folder.path());
  const Scene scene = set->load(Split::kTrain, 0, {.bsdf = false, .truth = false});
  CHECK(scene.bsdf.empty());
  CHECK(scene.normal.empty());
  CHECK(scene.depth.empty());
  CHECK(scene.mask == set->load(Split::kTrain, 0).mask);
}

TEST_CASE("the box is that of the coverage", "[scene_set]") {
  std::vector<float> coverage(6 * 4, 0.0F);
  CHECK(coverage_box(coverage, 6, 4) == Window{0, 0, 1, 1});
  coverage[1 * 6 + 2] = 0.1F;
  coverage[3 * 6 + 4] = 1.0F;
  CHECK(coverage_box(coverage, 6, 4) == Window{2, 1, 5, 4});
}

TEST_CASE("large values are clamped and counted, NaN is refused", "[scene_set]") {
  const TempFolder folder;
  SceneImages images = small_images(32, 32);
  images.image[5] = 1e6F;
  images.image[14] = -1e30F;
  SceneRecord record = small_record("0");
  CHECK(write_scene(folder.path(), 0, images, record).clamped == 2);
  CHECK(scene_is_intact(folder.path(), record));
  images.image[5] = std::nanf("");
  const std::string message = message_of([&] { write_scene(folder.path(), 1, images, record); });
  CHECK(contains(message, "scene 0"));
  CHECK_FALSE(fs::exists(folder / "scenes/000001.exr"));
}

TEST_CASE("a flipped bit in a scene is caught and named", "[scene_set]") {
  const TempFolder folder;
  write_small_set(folder.path(), 2, 0);
  std::vector<std::byte> bytes = read_file(folder / "scenes/000001.exr");
  bytes[bytes.size() / 2] ^= std::byte{4};
  write_file_atomically(folder / "scenes/000001.exr", bytes);
  const auto set = open_dataset(folder.path());
  CHECK_NOTHROW(set->load(Split::kTrain, 0));
  const std::string message = message_of([&] { set->load(Split::kTrain, 1); });
  CHECK(contains(message, "000001.exr"));
  CHECK(contains(message, "scene 1 is damaged"));
  fs::remove(folder / "scenes/000000.exr");
  CHECK(contains(message_of([&] { set->load(Split::kTrain, 0); }), "000000.exr"));
}

TEST_CASE("conventions of a set are converted or refused", "[scene_set]") {
  const TempFolder folder;
  write_small_set(folder.path(), 1, 0);
  const Scene ours = open_dataset(folder.path())->load(Split::kTrain, 0);
  const std::string fingerprint = open_dataset(folder.path())->facts().fingerprint;
  replace_in_file(folder / "dataset.toml", "s1 = \"I0 - I90\"", "s1 = \"I90 - I0\"");
  replace_in_file(folder / "dataset.toml", "\"per metre\"", "\"divided by 32\"");
  const auto flipped = open_dataset(folder.path());
  CHECK(flipped->facts().fingerprint != fingerprint);
  const Scene scene = flipped->load(Split::kTrain, 0);
  CHECK(scene.image[3] == -ours.image[3]);
  CHECK(scene.image[6] == ours.image[6]);
  CHECK(scene.bsdf[9 * 520 + 4] == -ours.bsdf[9 * 520 + 4]);
  CHECK(scene.bsdf[4] == -ours.bsdf[4]);  // outside the box too
  CHECK((*scene.sigma_t)[0] == 32 * (*ours.sigma_t)[0]);
  replace_in_file(folder / "dataset.toml", "z / 0.25 m", "z / 1 m");
  const std::string message = message_of([&] { open_dataset(folder.path()); });
  CHECK(contains(message, "dataset.toml"));
  CHECK(contains(message, "conventions.depth"));
  CHECK_THROWS_AS(open_dataset(folder.path()), Error);
}

TEST_CASE("the facts of a set come back", "[scene_set]") {
  const TempFolder folder;
  const SceneSetInfo info{.generator_version = "9.\"x\"",
                          .seed = std::numeric_limits<uint64_t>::max(),
                          .train = 5,
                          .test = 2,
                          .width = 64,
                          .height = 48,
                          .bsdf = "reflection",
                          .config_text = "[a]\nb = \"c\\\\d\"\n"};
  write_scene_set_info(folder.path(), info);
  const SceneSetInfo back = read_scene_set_info(folder.path());
  CHECK(back.generator_version == info.generator_version);
  CHECK(back.seed == info.seed);
  CHECK(back.train == 5);
  CHECK(back.height == 48);
  CHECK(back.bsdf == "reflection");
  CHECK(back.config_text == info.config_text);
}

TEST_CASE("a folder without a data set says what was looked for", "[dataset]") {
  const TempFolder folder;
  const std::string message = message_of([&] { open_dataset(folder.path()); });
  CHECK(contains(message, "dataset.toml"));
  CHECK(contains(message, "train.csv"));
  CHECK(contains(message, "p0.png"));
  CHECK(contains(message_of([&] { open_dataset(folder / "nothing"); }), "not a folder"));
}

}  // namespace
}  // namespace opaline::test
