#include "data/contact_sheet.h"

#include <catch2/catch.hpp>

#include "core/parallel.h"
#include "tests/data/support.h"

namespace opaline::test {
namespace {

TEST_CASE("scenes are spread from the first to the last", "[contact_sheet]") {
  const TempFolder folder;
  write_small_set(folder.path(), 5, 2, 16);
  const auto set = open_dataset(folder.path());
  const std::vector<ScenePlace> places = spread_scenes(*set, 4);
  REQUIRE(places.size() == 4);
  CHECK((places[0].split == Split::kTrain && places[0].index == 0));
  CHECK((places[1].split == Split::kTrain && places[1].index == 2));
  CHECK((places[3].split == Split::kTest && places[3].index == 1));
  CHECK(spread_scenes(*set, 100).size() == 7);
  CHECK(spread_scenes(*set, 0).empty());
}

TEST_CASE("a contact sheet is the same for any number of threads and shows what is damaged",
          "[contact_sheet]") {
  const TempFolder folder;
  write_small_set(folder.path(), 3, 1, 16);
  const auto set = open_dataset(folder.path());
  const Picture whole = contact_sheet(*set, {.scenes = 4, .tile = 16});
  {
    const ThreadsGuard one(1);
    CHECK(contact_sheet(*set, {.scenes = 4, .tile = 16}).rgb == whole.rgb);
  }
  // Two scenes beside each other, six tiles each.
  CHECK(whole.width > 2 * 6 * 16);
  CHECK(whole.height > 2 * 16);
  std::filesystem::remove(folder / "scenes/000002.exr");
  const Picture damaged = contact_sheet(*set, {.scenes = 4, .tile = 16});
  CHECK(damaged.width == whole.width);
  CHECK(damaged.height == whole.height);
  CHECK(damaged.rgb != whole.rgb);
  // Nothing is read of no scenes.
  CHECK(contact_sheet(*set, {.scenes = 0}).rgb.size() > 0);
}

TEST_CASE("pictures are averaged or repeated to a size", "[contact_sheet]") {
  const Picture four{.width = 4, .height = 2, .rgb = {10, 0, 0, 30, 0, 0, 1, 1, 1, 1, 1, 1,  //
                                                      20, 0, 0, 40, 0, 0, 1, 1, 1, 1, 1, 1}};
  const Picture half = scaled_to(four, 2);
  CHECK(half.width == 2);
  CHECK(half.height == 1);
  CHECK(half.rgb == std::vector<uint8_t>{25, 0, 0, 1, 1, 1});
  const Picture twice = scaled_to(four, 9);
  CHECK(twice.width == 8);
  CHECK(twice.height == 4);
  CHECK(twice.rgb[0] == 10);
  CHECK(twice.rgb[3] == 10);
  CHECK(twice.rgb[6] == 30);
}

TEST_CASE("hues of the angle of polarisation", "[contact_sheet]") {
  Scene scene;
  scene.width = 3;
  scene.height = 1;
  scene.mask = {1, 1, 0};
  scene.image.assign(27, 0.0F);
  for (size_t i = 0; i < 3; ++i) scene.image[9 * i] = 1.0F;
  scene.image[3] = 1.0F;       // 0 degrees
  scene.image[9 + 3] = -0.5F;  // 60 degrees: 2 x 60 = 120
  scene.image[9 + 6] = 0.5F * std::sqrt(3.0F);
  const Picture picture = picture_of_aop(scene);
  CHECK(picture.rgb == std::vector<uint8_t>{255, 0, 0, 0, 255, 0, 0, 0, 0});
  const std::array<uint8_t, 3> brightest = heat_colour(1.0);
  CHECK(std::equal(brightest.begin(), brightest.end(), picture_of_dop(scene, 1.0F).rgb.begin()));
}

}  // namespace
}  // namespace opaline::test
