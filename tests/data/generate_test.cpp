#include "data/generate.h"

#include <atomic>
#include <catch2/catch.hpp>

#include "core/file.h"
#include "core/file_lock.h"
#include "core/parallel.h"
#include "data/dataset.h"
#include "data/scene_set.h"
#include "tests/data/support.h"

using namespace opaline;
namespace fs = std::filesystem;

namespace {

GenerateConfig tiny() {
  GenerateConfig config;
  config.train = 4;
  config.test = 2;
  config.camera.width = config.camera.height = 16;
  config.spp = 1;
  config.photons = 200;
  return config;
}

std::vector<std::string> scene_bytes(const fs::path& root) {
  std::vector<std::string> all;
  for (int i = 0; i < 6; ++i) all.push_back(read_text(root / fmt::format("scenes/{:06}.exr", i)));
  return all;
}

}  // namespace

TEST_CASE("a set is rendered, indexed and readable") {
  const test::TempFolder folder;
  int64_t told = 0;
  const GenerateResult result = generate(
      tiny(), folder.path(), {.progress = [&](GenerateStep, int64_t done, int64_t) { told = done; }});
  CHECK(result.complete);
  CHECK(result.rendered == 6);
  CHECK(told == 6);
  const auto set = open_dataset(folder.path());
  REQUIRE(set->size(Split::kTrain) == 4);
  REQUIRE(set->size(Split::kTest) == 2);
  const Scene scene = set->load(Split::kTest, 1, {});
  CHECK(scene.width == 16);
  CHECK(scene.sigma_t.has_value());
  CHECK(scene.sh.has_value());
}

TEST_CASE("a set is the same to the bit whatever the threads and interruptions") {
  const test::TempFolder one, many;
  set_num_threads(1);
  generate(tiny(), one.path());
  set_num_threads(3);
  std::atomic<int> asked{0};
  const GenerateResult stopped = generate(tiny(), many.path(), {.stop = [&] { return ++asked > 3; }});
  CHECK_FALSE(stopped.complete);
  const GenerateResult rest = generate(tiny(), many.path());
  set_num_threads(0);
  CHECK(rest.complete);
  CHECK(rest.kept == stopped.rendered);
  CHECK(rest.rendered == 6 - stopped.rendered);
  CHECK(scene_bytes(one.path()) == scene_bytes(many.path()));
  const auto a = read_scene_index(one.path() / "train.jsonl"),
             b = read_scene_index(many.path() / "train.jsonl");
  REQUIRE(a.size() == b.size());
  for (size_t i = 0; i < a.size(); ++i) CHECK(a[i].xxh64 == b[i].xxh64);
}

TEST_CASE("damaged and missing scenes are rendered again, torn lines dropped") {
  const test::TempFolder folder;
  generate(tiny(), folder.path());
  const auto before = scene_bytes(folder.path());
  write_file_atomically(folder.path() / "scenes/000001.exr", std::string_view("damaged"));
  fs::remove(folder.path() / "scenes/000004.exr");
  const std::string index = read_text(folder.path() / "train.jsonl");
  write_file_atomically(folder.path() / "train.jsonl", std::string_view(index).substr(0, index.size() - 20));
  const GenerateResult again = generate(tiny(), folder.path());
  CHECK(again.rendered == 3);
  CHECK(scene_bytes(folder.path()) == before);
}

TEST_CASE("a file damaged behind the index is found at the end and rendered again") {
  const test::TempFolder folder;
  generate(tiny(), folder.path());
  const auto before = scene_bytes(folder.path());
  std::string damaged = before[2];
  damaged[damaged.size() / 2] = static_cast<char>(damaged[damaged.size() / 2] ^ 1);
  write_file_atomically(folder.path() / "scenes/000002.exr", damaged);
  std::vector<std::pair<GenerateStep, int64_t>> told;
  const GenerateResult again = generate(
      tiny(), folder.path(),
      {.progress = [&](GenerateStep step, int64_t done, int64_t) { told.emplace_back(step, done); }});
  CHECK(again.damaged == 1);
  CHECK(again.rendered == 1);
  CHECK(again.kept == 5);
  CHECK(again.verified == 6);
  CHECK(again.complete);
  CHECK(scene_bytes(folder.path()) == before);
  REQUIRE(told.size() > 8);
  CHECK(told.front() == std::pair(GenerateStep::kVerify, int64_t{0}));  // nothing was missing
  CHECK(told[7] == std::pair(GenerateStep::kRender, int64_t{5}));
  CHECK(told.back() == std::pair(GenerateStep::kVerify, int64_t{6}));
}

TEST_CASE("what a killed run left half-written goes, and a line that does not parse is made again") {
  const test::TempFolder folder;
  generate(tiny(), folder.path());
  const std::string index = read_text(folder.path() / "train.jsonl");
  std::string broken = index;
  broken[index.find('\n') + 1] = '?';  // the second line's first character
  write_file_atomically(folder.path() / "train.jsonl", broken);
  for (const char* name : {"scenes/000003.exr.tmp.12", "train.jsonl.tmp.12", "dataset.toml.tmp.12"}) {
    write_file_atomically(folder.path() / name, std::string_view("half"));
  }
  const GenerateResult again = generate(tiny(), folder.path());
  CHECK(again.rendered == 1);
  CHECK(again.kept == 5);
  for (const fs::directory_entry& entry : fs::recursive_directory_iterator(folder.path())) {
    CHECK(entry.path().string().find(".tmp.") == std::string::npos);
  }
  CHECK(read_scene_index(folder.path() / "train.jsonl").size() == 4);
}

TEST_CASE("two renderers do not share a folder") {
  const test::TempFolder folder;
  {
    const FileLock other(folder.path() / "lock", "is busy");
    CHECK_THROWS_WITH(generate(tiny(), folder.path()), Catch::Contains("is rendering into this folder"));
  }
  CHECK(generate(tiny(), folder.path()).complete);
}

TEST_CASE("a scene that cannot be written ends the run and leaves the others in the index") {
  const test::TempFolder folder;
  fs::create_directories(folder.path() / "scenes/000003.exr");  // a folder where the file should be
  CHECK_THROWS_WITH(generate(tiny(), folder.path()), Catch::Contains("000003.exr"));
  fs::remove(folder.path() / "scenes/000003.exr");
  const GenerateResult rest = generate(tiny(), folder.path());
  CHECK(rest.complete);
  CHECK(rest.kept >= 1);
}

TEST_CASE("another config is not mixed into a set") {
  const test::TempFolder folder;
  generate(tiny(), folder.path());
  GenerateConfig other = tiny();
  other.ranges.bump = 0.1;
  CHECK_THROWS_AS(generate(other, folder.path()), UsageError);
  // More scenes of the same config are.
  other = tiny();
  other.test = 3;
  CHECK(generate(other, folder.path()).rendered == 1);
}

TEST_CASE("the table [render] is read strictly") {
  const auto read = [](std::string_view text) {
    TomlConfig config = TomlConfig::from_text(text, "c.toml");
    const GenerateConfig result = read_generate_config(config.root().table("render"));
    config.finish();
    return result;
  };
  CHECK(read("[render]\ntrain = 3\nfamilies = [\"blend\"]\n").ranges.families.size() == 1);
  CHECK_THROWS_WITH(read("[render]\nfamilies = [\"blind\"]\n"), Catch::Contains("did you mean \"blend\""));
  CHECK_THROWS_AS(read("[render]\nradius = [0.2, 0.1]\n"), UsageError);
  CHECK_THROWS_AS(read("[render]\nradius = [0.1, 0.25]\noffset = 0.1\n"), UsageError);
  CHECK_THROWS_AS(read("[render]\nspp = 0\n"), UsageError);
  CHECK_THROWS_WITH(read("[render]\nfamily = 1\n"), Catch::Contains("families"));
  const GenerateConfig rooms = read("[render]\ncontrast = [10, 100]\nlamp = [5, 6.5]\nobjects = \"some\"\n");
  CHECK(rooms.ranges.room.contrast.high == 100.0);
  CHECK(rooms.ranges.room.lamp.high == 6.5);
  CHECK_THAT(rooms.text(), Catch::Contains("lamp = [5, 6.5]") && Catch::Contains("objects = \"some\""));
  CHECK_THROWS_AS(read("[render]\ncontrast = [0, 100]\n"), UsageError);
  CHECK_THROWS_AS(read("[render]\nlamp = [0.1, 2]\n"), UsageError);
  CHECK_THROWS_AS(read("[render]\ntest_share = 1.5\n"), UsageError);
}
