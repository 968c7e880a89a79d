// Writes the synthetic scenes of the training tests as a data set on disk, for tests of the program itself.
//   make_scenes FOLDER TRAIN TEST SIZE
#include <cstdio>
#include <string>
#include <vector>

#include "core/error.h"
#include "data/scene_set.h"
#include "tests/train/synthetic.h"

namespace opaline {
namespace {

SceneRecord write(const std::filesystem::path& root, const Scene& scene, int64_t number) {
  SceneImages images{.width = scene.width, .height = scene.height};
  images.image = scene.image;
  images.bsdf = scene.bsdf;
  images.normal = scene.normal;
  images.depth = scene.depth;
  images.coverage.assign(scene.mask.begin(), scene.mask.end());
  SceneRecord record;
  record.id = scene.id;
  for (size_t c = 0; c < 3; ++c) {
    record.sigma_t[c] = static_cast<double>((*scene.sigma_t)[c]);
    record.albedo[c] = static_cast<double>((*scene.albedo)[c]);
  }
  record.g = static_cast<double>(*scene.g);
  record.flash = static_cast<double>(*scene.flash);
  for (size_t i = 0; i < record.sh.size(); ++i) record.sh[i] = static_cast<double>((*scene.sh)[i]);
  record.object = "sphere";
  record.environment = "none";
  record.spp = 1;
  write_scene(root, number, images, record);
  return record;
}

void make_scenes(const std::filesystem::path& root, int64_t train, int64_t test, int size) {
  const test::SyntheticDataset dataset({.train = train, .test = test, .size = size});
  int64_t number = 0;
  for (const Split split : {Split::kTrain, Split::kTest}) {
    std::vector<SceneRecord> records;
    for (int64_t i = 0; i < dataset.size(split); ++i) {
      records.push_back(write(root, dataset.load(split, i, {}), number++));
    }
    write_scene_index(root / (std::string(to_string(split)) + ".jsonl"), records);
  }
  write_scene_set_info(root, {.generator = "synthetic",
                              .generator_version = "1",
                              .train = train,
                              .test = test,
                              .width = size,
                              .height = size});
}

}  // namespace
}  // namespace opaline

int main(int argc, char** argv) {
  if (argc != 5) {
    std::fprintf(stderr, "usage: make_scenes FOLDER TRAIN TEST SIZE\n");
    return 2;
  }
  try {
    opaline::make_scenes(argv[1], std::stoll(argv[2]), std::stoll(argv[3]), std::stoi(argv[4]));
  } catch (const std::exception& error) {
    std::fprintf(stderr, "make_scenes: %s\n", error.what());
    return 1;
  }
  return 0;
}
