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
  CHECK(contains(refusal("\"seconds\":0.25", "\"seconds\":0.25,\"sections\":[[1,\"a\"]]"),
                 "'sections' must hold 6"));
  CHECK(contains(refusal("\"seconds\":0.25", "\"seconds\":0.25,\"sections\":[1,2,3,4,5,6]"), "'sections'"));
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

TEST_CASE("masked inputs need the object's lines alone", "[scene_set]") {
  const TempFolder folder;
  write_small_set(folder.path(), 1, 0, 64);
  const auto set = open_dataset(folder.path());
  const Scene whole = set->load(Split::kTrain, 0);
  const Scene part = set->load(Split::kTrain, 0, {.bsdf = false, .whole = false});
  const SceneRecord record = read_scene_index(folder / "train.jsonl").front();
  const Window window = grown(record.box, 1, 64, 64);
  REQUIRE(part.window == window);
  for (int y = window.y0; y < window.y1; ++y) {
    for (int x = window.x0; x < window.x1; ++x) {
      const auto from = static_cast<size_t>((y - window.y0) * window.width() + x - window.x0) * 9;
      const auto to = static_cast<size_t>(y * 64 + x) * 9;
      for (size_t c = 0; c < 9; ++c) REQUIRE(part.image[from + c] == whole.image[to + c]);
    }
  }
  CHECK(part.mask == whole.mask);
  CHECK(part.normal == whole.normal);
  CHECK(part.depth == whole.depth);

  // Sections tile the file; those around the box and the pure-BSDF part are not looked at.
  REQUIRE(record.sections.has_value());
  const fs::path file = folder / record.file;
  std::vector<std::byte> bytes = read_file(file);
  int64_t sum = 0;
  std::array<int64_t, kSceneSections> begin{};
  for (size_t i = 0; i < kSceneSections; ++i) {
    begin[i] = sum;
    sum += (*record.sections)[i].bytes;
    CHECK((*record.sections)[i].bytes > 0);
  }
  CHECK(sum == static_cast<int64_t>(bytes.size()));
  const auto loads_with_flip = [&](SceneSection section, const LoadOptions& options) {
    std::vector<std::byte> damaged = bytes;
    const auto i = static_cast<size_t>(section);
    damaged[static_cast<size_t>(begin[i] + (*record.sections)[i].bytes / 2)] ^= std::byte{16};
    write_file_atomically(file, damaged);
    try {
      set->load(Split::kTrain, 0, options);
      return true;
    } catch (const Error& e) {
      CHECK(contains(e.what(), "scene 0 is damaged"));
      return false;
    }
  };
  const LoadOptions object{.bsdf = false, .whole = false};
  const LoadOptions light{.bsdf = false, .whole = true};
  using enum SceneSection;
  for (const SceneSection section : {kHead, kBox, kTruth}) CHECK_FALSE(loads_with_flip(section, object));
  for (const SceneSection section : {kAbove, kBelow, kBsdf}) CHECK(loads_with_flip(section, object));
  for (const SceneSection section : {kHead, kAbove, kBox, kBelow, kTruth}) {
    CHECK_FALSE(loads_with_flip(section, light));
  }
  CHECK(loads_with_flip(kBsdf, light));
  for (size_t i = 0; i < kSceneSections; ++i) CHECK_FALSE(loads_with_flip(static_cast<SceneSection>(i), {}));
  bytes.pop_back();
  write_file_atomically(file, bytes);
  CHECK(contains(message_of([&] { set->load(Split::kTrain, 0, object); }), "the index says"));
}

TEST_CASE("a set without sections is read whole", "[scene_set]") {
  const TempFolder folder;
  write_small_set(folder.path(), 1, 0, 64);
  const Scene expected = open_dataset(folder.path())->load(Split::kTrain, 0, {.bsdf = false, .whole = false});
  std::vector<SceneRecord> records = read_scene_index(folder / "train.jsonl");
  records[0].sections.reset();
  write_scene_index(folder / "train.jsonl", records);
  const Scene scene = open_dataset(folder.path())->load(Split::kTrain, 0, {.bsdf = false, .whole = false});
  CHECK(scene.window == expected.window);
  CHECK(scene.image == expected.image);
}

TEST_CASE("an object that fills the image can be read in part too", "[scene_set]") {
  const TempFolder folder;
  SceneImages images = small_images(32, 32);
  images.coverage.assign(images.coverage.size(), 1.0F);
  images.normal.clear();
  for (size_t i = 0; i < images.coverage.size(); ++i) images.normal.insert(images.normal.end(), {0, 0, 1});
  SceneRecord record = small_record("0");
  write_scene(folder.path(), 0, images, record);
  CHECK((*record.sections)[static_cast<size_t>(SceneSection::kAbove)].bytes == 0);
  write_scene_index(folder / "train.jsonl", {record});
  write_scene_set_info(folder.path(), {.train = 1, .width = 32, .height = 32});
  const auto set = open_dataset(folder.path());
  CHECK(set->load(Split::kTrain, 0, {.bsdf = false, .whole = false}).image ==
        set->load(Split::kTrain, 0).image);
}

TEST_CASE("every way of storing scenes gives the same scene", "[scene_set]") {
  const TempFolder folder;
  std::vector<SceneRecord> records;
  for (const ExrCompression compression : {ExrCompression::kNone, ExrCompression::kRle, ExrCompression::kZips,
                                           ExrCompression::kZip, ExrCompression::kPiz}) {
    SceneRecord record = small_record(std::to_string(records.size()));
    write_scene(folder.path(), static_cast<int64_t>(records.size()), small_images(64, 64), record,
                {.compression = compression});
    records.push_back(record);
  }
  write_scene_index(folder / "train.jsonl", records);
  write_scene_set_info(folder.path(), {.train = 5, .width = 64, .height = 64});
  const auto set = open_dataset(folder.path());
  for (const bool whole : {true, false}) {
    const LoadOptions options{.bsdf = whole, .whole = whole};
    const Scene first = set->load(Split::kTrain, 0, options);
    for (int64_t i = 1; i < 5; ++i) {
      const Scene scene = set->load(Split::kTrain, i, options);
      CHECK(scene.image == first.image);
      CHECK(scene.bsdf == first.bsdf);
      CHECK(scene.normal == first.normal);
    }
  }
}

TEST_CASE("an index is read in pieces, its lines and ids checked", "[scene_set]") {
  const TempFolder folder;
  write_small_set(folder.path(), 1, 0);
  SceneRecord record = read_scene_index(folder / "train.jsonl").front();
  std::string text;
  for (int i = 0; i < 3000; ++i) {  // over two pieces of a mebibyte
    record.id = "scene-" + std::to_string(i);
    text += to_json_line(record) + (i % 7 == 0 ? "\n\n" : "\n");
  }
  REQUIRE(text.size() > (size_t{2} << 20));
  write_file_atomically(folder / "train.jsonl", std::string_view(text));
  const auto set = open_dataset(folder.path());
  REQUIRE(set->size(Split::kTrain) == 3000);
  for (const int64_t i : {0, 1, 7, 1100, 1101, 2999}) {
    CHECK(set->id(Split::kTrain, i) == "scene-" + std::to_string(i));
  }
  CHECK(set->load(Split::kTrain, 2999).id == "scene-2999");
  record.id = "scene-17";
  append_scene_record(folder / "train.jsonl", record);
  CHECK(contains(message_of([&] { open_dataset(folder.path()); }), "lists scene scene-17 twice"));
  write_file_atomically(folder / "train.jsonl", text + "{\"id\": 3}\n");
  CHECK(contains(message_of([&] { open_dataset(folder.path()); }), "train.jsonl:3430"));
  // The open set goes on with the file that it has checked.
  CHECK(set->id(Split::kTrain, 5) == "scene-5");
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
