#include "data/check.h"

#include "tests/data/support.h"

namespace opaline::test {
namespace {

namespace fs = std::filesystem;

TEST_CASE("a sound set is found sound and in our frame", "[check]") {
  const TempFolder folder;
  write_small_set(folder.path(), 3, 2);
  const DatasetCheck check = check_dataset(*open_dataset(folder.path()));
  const std::string text = to_text(check);
  INFO(text);
  CHECK(check.sound());
  CHECK(check.frame.ours());
  CHECK(check.frame.slope > 0.9);
  CHECK(check.frame.silhouette > 0.9);
  REQUIRE(check.splits.size() == 2);
  CHECK(check.splits[0].scenes.size() == 3);
  CHECK(contains(text, "train: 3 scenes, 3 usable"));
  CHECK(contains(text, "x right, y up, larger depth is nearer"));
  CHECK(contains(text, "0 problems, 0 warnings"));
}

TEST_CASE("every flip of the frame is named", "[check]") {
  for (unsigned flips = 0; flips < 8; ++flips) {
    const TempFolder folder;
    SceneImages images = small_images(48, 48);
    for (size_t i = 0; i < images.depth.size(); ++i) {
      if ((flips & 1U) != 0) images.normal[3 * i] *= -1;
      if ((flips & 2U) != 0) images.normal[3 * i + 1] *= -1;
      if ((flips & 4U) != 0) images.depth[i] *= -1;
    }
    SceneRecord record = small_record("0");
    write_scene(folder.path(), 0, images, record);
    write_scene_index(folder / "test.jsonl", {record});
    write_scene_set_info(folder.path(), {.test = 1, .width = 48, .height = 48});
    const DatasetCheck check = check_dataset(*open_dataset(folder.path()));
    REQUIRE(check.frame.known);
    CHECK(check.frame.flip_x == ((flips & 1U) != 0));
    CHECK(check.frame.flip_y == ((flips & 2U) != 0));
    CHECK(check.frame.flip_depth == ((flips & 4U) != 0));
    CHECK(check.sound() == (flips == 0));  // ours promises a frame
  }
}

TEST_CASE("damage is counted and named", "[check]") {
  const TempFolder folder;
  write_small_set(folder.path(), 3, 0);
  std::vector<std::byte> bytes = read_file(folder / "scenes/000001.exr");
  bytes.resize(bytes.size() - 7);
  write_file_atomically(folder / "scenes/000001.exr", bytes);
  fs::copy_file(folder / "scenes/000000.exr", folder / "scenes/000099.exr");
  write_scene_set_info(folder.path(), {.train = 4, .test = 0, .width = 32, .height = 32});
  const DatasetCheck check = check_dataset(*open_dataset(folder.path()));
  CHECK_FALSE(check.sound());
  const std::string text = to_text(check);
  INFO(text);
  CHECK(contains(text, "promises 4 train scenes, train.jsonl lists 3"));
  CHECK(contains(text, "000001.exr"));
  CHECK(contains(text, "scenes/ has 1 files that no index lists"));
  CHECK(contains(text, "2 problems, 1 warnings"));
  CHECK_FALSE(contains(to_text(check, 0), "000001.exr"));
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
  const std::string text = to_text(check_dataset(*open_dataset(folder.path())));
  INFO(text);
  CHECK(contains(text, "the mask is empty"));
  CHECK(contains(text, "g is 0.95"));
}

}  // namespace
}  // namespace opaline::test
