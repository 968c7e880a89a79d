#include "data/assets.h"

#include <algorithm>
#include <catch2/catch.hpp>
#include <numbers>
#include <set>

#include "data/exr.h"
#include "data/generate.h"
#include "data/hdr.h"
#include "data/panorama.h"
#include "data/png.h"
#include "data/scene_set.h"
#include "tests/data/support.h"

using namespace opaline;
namespace fs = std::filesystem;
using render::Rgb;

namespace {

void write(const fs::path& path, const std::string& text) {
  fs::create_directories(path.parent_path());
  write_file_atomically(path, std::string_view(text));
}

std::string box_obj(double width) {
  return fmt::format(
      "v 0 0 0\nv {0} 0 0\nv {0} 1 0\nv 0 1 0\nv 0 0 1\nv {0} 0 1\nv {0} 1 1\nv 0 1 1\nf 4 3 2 1\nf 5 6 7 8\n"
      "f 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n",
      width);
}

void write_map(const fs::path& path, int channels = 1) {
  std::vector<uint8_t> pixels(size_t{32} * 16 * static_cast<size_t>(channels));
  for (size_t i = 0; i < pixels.size(); ++i) pixels[i] = static_cast<uint8_t>(i * 5);
  fs::create_directories(path.parent_path());
  write_png(path, 32, 16, channels, pixels);
}

void write_panorama(const fs::path& path, float bad = 1.0F, int width = 64) {
  ExrPart part{
      .name = "", .window = {0, 0, width, 32}, .channels = {"B", "G", "R"}, .half = false, .pixels = {}};
  part.pixels.assign(static_cast<size_t>(part.window.pixels()) * 3, 1.0F);
  part.pixels[3 * 100 + 1] = bad;
  fs::create_directories(path.parent_path());
  write_exr(path, {.width = width, .height = 32, .parts = {part}});
}

std::vector<std::byte> hdr_bytes(const std::string& header, const std::vector<int>& data) {
  std::vector<std::byte> bytes;
  for (const char c : header) bytes.push_back(static_cast<std::byte>(c));
  for (const int v : data) bytes.push_back(static_cast<std::byte>(v));
  return bytes;
}

const std::string kHdr = "#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n";

}  // namespace

TEST_CASE("Radiance files are read flat and run-length coded") {
  const auto value = [](int mantissa, int exponent) { return std::ldexp(mantissa + 0.5, exponent - 136); };
  const HdrImage flat =
      decode_hdr(hdr_bytes(kHdr + "-Y 1 +X 4\n", {128, 64, 0, 129, 1, 1, 1, 2, 0, 0, 0, 0}), "a.hdr");
  REQUIRE(flat.pixels.size() == 12);
  CHECK(flat.pixels[0] == Approx(value(128, 129)));
  CHECK(flat.pixels[6] == flat.pixels[0]);  // repeated twice
  CHECK(flat.pixels[9] == 0.0F);
  std::vector<int> coded{2, 2, 0, 8};
  for (int channel = 0; channel < 3; ++channel) {
    coded.insert(coded.end(), {128 + 5, 10 * (channel + 1), 3, 1, 2, 3});
  }
  coded.insert(coded.end(), {128 + 8, 130});
  const HdrImage runs = decode_hdr(hdr_bytes(kHdr + "-Y 1 +X 8\n", coded), "a.hdr");
  REQUIRE(runs.pixels.size() == 24);
  CHECK(runs.pixels[1] == Approx(value(20, 130)));
  CHECK(runs.pixels[3 * 6 + 2] == Approx(value(2, 130)));
  const HdrImage exposed =
      decode_hdr(hdr_bytes("#?RADIANCE\nEXPOSURE=2.0\n\n-Y 1 +X 1\n", {128, 64, 0, 129}), "a.hdr");
  CHECK(exposed.pixels[0] == Approx(0.5 * value(128, 129)));
}

TEST_CASE("damaged Radiance files are refused") {
  const auto message = [](const std::string& header, const std::vector<int>& data) {
    return test::message_of([&] { decode_hdr(hdr_bytes(header, data), "a.hdr"); });
  };
  CHECK_THAT(message("#?RADIANC\n\n", {}), Catch::Contains("a.hdr") && Catch::Contains("#?RADIANCE"));
  CHECK_THAT(message("#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n", {}), Catch::Contains("xyze"));
  CHECK_THAT(message(kHdr + "+X 4 -Y 1\n", {}), Catch::Contains("size"));
  CHECK_THAT(message(kHdr + "-Y 30000 +X 30000\n", {1}), Catch::Contains("30000 x 30000"));
  CHECK_THAT(message(kHdr + "-Y 16 +X 16\n", {1}), Catch::Contains("more than"));
  CHECK_THAT(message(kHdr + "-Y 1 +X 2\n", {9, 9, 9, 9}), Catch::Contains("ends early"));
  CHECK_THAT(message(kHdr + "-Y 1 +X 2\n", {1, 1, 1, 9}), Catch::Contains("repeats"));
  CHECK_THAT(message(kHdr + "-Y 1 +X 8\n", {2, 2, 0, 8, 128 + 9, 1}), Catch::Contains("run of 9"));
  CHECK_THAT(message(kHdr + "-Y 1 +X 8\n", {2, 2, 0, 8, 0, 1}), Catch::Contains("run of 0"));
}

TEST_CASE("panoramas shrink without losing light") {
  const int64_t rows = 48, width = 96;
  std::vector<Rgb> texels(static_cast<size_t>(rows * width), Rgb{1.0, 2.0, 3.0});
  texels[static_cast<size_t>(5 * width + 17)] = {1e5, 0.0, 0.0};
  for (const int64_t height : {16, 20, 48}) {  // divisors of 48 and not
    const std::vector<Rgb> small = shrink_panorama(texels, width, height);
    REQUIRE(small.size() == static_cast<size_t>(2 * height * height));
    const auto light = [](const std::vector<Rgb>& t, int64_t h) {
      double sum = 0.0;
      for (size_t i = 0; i < t.size(); ++i) {
        const auto row = static_cast<double>(static_cast<int64_t>(i) / (2 * h));
        const double band = std::numbers::pi / static_cast<double>(h);
        sum += t[i][0] * (std::cos(band * row) - std::cos(band * (row + 1.0))) / static_cast<double>(2 * h);
      }
      return sum;
    };
    CHECK(light(small, height) == Approx(light(texels, rows)).epsilon(1e-9));
    CHECK(small.back()[1] == Approx(2.0));
  }
}

TEST_CASE("panoramas that are none are refused with the reason") {
  const test::TempFolder folder;
  write_panorama(folder / "good.exr");
  CHECK(read_panorama(folder / "good.exr", 16).height() == 16);
  CHECK(read_panorama(folder / "good.exr", 128).height() == 32);
  const auto message = [&](const std::string& name) {
    return test::message_of([&] { read_panorama(folder / name, 16); });
  };
  write_panorama(folder / "negative.exr", -1.0F);
  CHECK_THAT(message("negative.exr"), Catch::Contains("-1 in row 1, column 36"));
  write_panorama(folder / "nan.exr", std::nanf(""));
  CHECK_THAT(message("nan.exr"), Catch::Contains("nan in row 1"));
  write_panorama(folder / "square.exr", 1.0F, 40);
  CHECK_THAT(message("square.exr"), Catch::Contains("40 x 32"));
}

TEST_CASE("files keep their split when others come, and none is in both") {
  const test::TempFolder folder;
  const auto fill = [&](int first, int count) {
    for (int i = first; i < first + count; ++i)
      write(folder / fmt::format("0269/{:03}/models/model_normalized.obj", i), box_obj(1.0 + i));
  };
  fill(0, 40);
  const AssetConfig config{.objects = folder.path().string(), .test_share = 0.3};
  const auto names = [&](uint64_t seed) {
    const AssetFolders assets(config, seed, true, true);
    const auto& a = assets.train().objects.names;
    const auto& b = assets.test().objects.names;
    return std::pair(std::set(a.begin(), a.end()), std::set(b.begin(), b.end()));
  };
  const auto [train, test] = names(1);
  CHECK(train.size() + test.size() == 40);
  CHECK(test.size() >= 5);
  CHECK(test.size() <= 20);
  CHECK(train.contains("0269/000") != test.contains("0269/000"));
  CHECK(names(2).second != test);
  fill(40, 20);
  const auto [more_train, more_test] = names(1);
  CHECK(std::includes(more_train.begin(), more_train.end(), train.begin(), train.end()));
  CHECK(std::includes(more_test.begin(), more_test.end(), test.begin(), test.end()));
}

TEST_CASE("subfolders train and test are the split") {
  const test::TempFolder folder;
  write(folder / "train/a.obj", box_obj(1));
  write(folder / "test/b.PLY", "ply\n");
  write(folder / "test/notes.txt", "");
  const AssetFolders assets({.objects = folder.path().string()}, 1, true, true);
  CHECK(assets.train().objects.names == std::vector<std::string>{"a"});
  CHECK(assets.test().objects.names == std::vector<std::string>{"b"});
  CHECK(assets.train().objects.load(0).has_value());
  CHECK(assets.skipped().empty());
  CHECK_FALSE(assets.test().objects.load(0).has_value());
  REQUIRE(assets.skipped().size() == 1);
  CHECK_THAT(assets.skipped().begin()->second, Catch::Contains("b.PLY"));
}

TEST_CASE("a folder that cannot serve is refused before anything is written") {
  const test::TempFolder folder;
  CHECK_THROWS_WITH(AssetFolders({.bumps = "/nowhere"}, 1, true, true),
                    Catch::Contains("render.bumps") && Catch::Contains("/nowhere"));
  write(folder / "a.obj", box_obj(1));
  const AssetConfig config{.objects = folder.path().string(), .test_share = 0.0};
  CHECK_THROWS_WITH(AssetFolders(config, 1, true, true),
                    Catch::Contains("test scenes") && Catch::Contains("test_share"));
  CHECK_NOTHROW(AssetFolders(config, 1, true, false));
  CHECK(AssetFolders({}, 1, true, true).text().empty());
}

TEST_CASE("height maps are grey") {
  const test::TempFolder folder;
  write_map(folder / "grey.png");
  const render::HeightMap map = read_height_map(folder / "grey.png");
  CHECK(map.width == 32);
  CHECK(map.values[1] == 5.0F);
  write_map(folder / "colour.png", 3);
  CHECK_THROWS_WITH(read_height_map(folder / "colour.png"),
                    Catch::Contains("colour.png") && Catch::Contains("coloured"));
}

TEST_CASE("scenes are rendered from folders, and what cannot be used is named") {
  const test::TempFolder folder;
  for (int i = 0; i < 3; ++i) write(folder / fmt::format("objects/train/{}.obj", i), box_obj(1.0 + i));
  write(folder / "objects/test/one.obj", box_obj(0.5));
  write(folder / "objects/train/open.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n");
  for (const char* split : {"train", "test"}) {
    write_map(folder / fmt::format("bumps/{}/{}.png", split, split));
    write_panorama(folder / fmt::format("panoramas/{}/{}.exr", split, split));
  }
  GenerateConfig config;
  config.train = 8;
  config.test = 2;
  config.camera.width = config.camera.height = 16;
  config.spp = 1;
  config.photons = 100;
  config.assets = {.objects = (folder / "objects").string(),
                   .bumps = (folder / "bumps").string(),
                   .panoramas = (folder / "panoramas").string()};
  const GenerateResult result = generate(config, folder / "set");
  CHECK(result.complete);
  REQUIRE(result.skipped.size() == 1);
  CHECK_THAT(result.skipped.begin()->second, Catch::Contains("open.obj") && Catch::Contains("not closed"));
  for (const SceneRecord& record : read_scene_index(folder / "set/train.jsonl")) {
    CHECK_THAT(record.object, Catch::Contains(" + train"));
    CHECK(record.environment == "train");
  }
  for (const SceneRecord& record : read_scene_index(folder / "set/test.jsonl")) {
    CHECK(record.object == "one + test");
    CHECK(record.environment == "test");
  }
  // A file more is another set.
  write(folder / "objects/train/new.obj", box_obj(2));
  CHECK_THROWS_AS(generate(config, folder / "set"), UsageError);
}
