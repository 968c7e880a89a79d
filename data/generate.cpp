#include "data/generate.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <map>
#include <mutex>

#include "core/error.h"
#include "core/parallel.h"
#include "data/scene_set.h"

namespace opaline {
namespace {

namespace fs = std::filesystem;

constexpr std::string_view kVersion = "0.1.0";
constexpr uint32_t kMostAttempts = 1000;

/// The index of one split while it grows: in the file in the order of completion, sorted at the end.
class Index {
 public:
  Index(fs::path path, const fs::path& root, int64_t first, int64_t count) : path_(std::move(path)) {
    if (!fs::exists(path_)) return;
    for (SceneRecord& record : read_scene_index(path_, true)) {
      const int64_t number = number_of(record);
      const bool wanted = number >= first && number < first + count;
      if (wanted && scene_is_intact(root, record)) records_[number] = std::move(record);
    }
    sort();  // drops what is torn, damaged or no longer wanted
  }

  bool has(int64_t number) const { return records_.contains(number); }
  int64_t size() const { return static_cast<int64_t>(records_.size()); }
  void add(int64_t number, const SceneRecord& record) {
    append_scene_record(path_, record);
    records_[number] = record;
  }
  void sort() const {
    std::vector<SceneRecord> all;
    for (const auto& [number, record] : records_) all.push_back(record);
    write_scene_index(path_, all);
  }

 private:
  static int64_t number_of(const SceneRecord& record) {
    const std::string name = fs::path(record.file).stem().string();
    const bool digits = !name.empty() && name.find_first_not_of("0123456789") == std::string::npos;
    return digits && name.size() < 12 ? std::stoll(name) : -1;
  }

  fs::path path_;
  std::map<int64_t, SceneRecord> records_;
};

struct Rendered {
  SceneImages images;
  SceneRecord record;
  render::PathFaults faults;
  int64_t redrawn = 0;
};

Rendered render_number(const GenerateConfig& config, const AssetFolders& assets, int64_t number) {
  const auto begin = std::chrono::steady_clock::now();
  const auto id = static_cast<uint32_t>(number);
  Rendered result;
  for (uint32_t attempt = 0;; ++attempt) {
    if (attempt == kMostAttempts) {
      fail_usage("render",
                 "scene {}: {} draws in a row have an object that leaves the picture or covers no pixel; "
                 "lower render.radius or render.offset, or raise render.size",
                 number, attempt);
    }
    const render::SceneModel scene =
        render::draw_scene(config.ranges, config.camera, config.seed, id, attempt,
                           number < config.train ? assets.train() : assets.test());
    if (!render::likely_well_framed(scene, config.camera)) {
      ++result.redrawn;
      continue;
    }
    render::SceneRender made = render_scene(scene, config.camera,
                                            {.spp = config.spp,
                                             .bsdf = config.bsdf,
                                             .guide = {.photons = config.photons},
                                             .seed = config.seed,
                                             .number = id});
    if (!render::well_framed(made.coverage, made.width, made.height)) {
      ++result.redrawn;
      continue;
    }
    SceneRecord& record = result.record;
    record.id = fmt::format("{:06}", number);
    record.sigma_t = scene.medium.sigma_t;
    record.albedo = scene.medium.albedo;
    record.g = scene.medium.g;
    record.flash = scene.light.flash.radiance;
    const auto sh = scene.light.environment.project();
    for (size_t c = 0; c < 3; ++c)
      std::copy(sh[c].begin(), sh[c].end(), record.sh.begin() + 9 * static_cast<std::ptrdiff_t>(c));
    record.object = scene.object;
    record.environment = scene.environment;
    record.seed = config.seed;
    record.spp = config.spp;
    result.faults = made.faults;
    result.images = {.width = made.width,
                     .height = made.height,
                     .image = std::move(made.image),
                     .bsdf = std::move(made.bsdf),
                     .normal = std::move(made.normal),
                     .depth = std::move(made.depth),
                     .coverage = std::move(made.coverage)};
    break;
  }
  result.record.seconds = std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
  return result;
}

void compare_with_existing(const std::string& text, const fs::path& root) {
  const SceneSetInfo before = read_scene_set_info(root);
  if (before.config_text == text && before.generator_version == kVersion) return;
  fail_usage(root.string(),
             "holds a data set of another config, generator {}:\n{}\nasked for now, generator {}:\n{}\n"
             "Choose another folder, or remove this one",
             before.generator_version, before.config_text, kVersion, text);
}

}  // namespace

GenerateResult generate(const GenerateConfig& config, const fs::path& root, const GenerateOptions& options) {
  const int64_t total = config.train + config.test;
  if (total == 0) fail_usage("render", "no scenes to render: set render.train and render.test");
  const AssetFolders assets(config.assets, config.seed, config.train > 0, config.test > 0);
  const std::string text = config.text() + assets.text();
  fs::create_directories(root / "scenes");
  if (fs::exists(root / "dataset.toml")) compare_with_existing(text, root);
  write_scene_set_info(root,
                       {.generator_version = std::string(kVersion),
                        .seed = config.seed,
                        .train = config.train,
                        .test = config.test,
                        .width = config.camera.width,
                        .height = config.camera.height,
                        .bsdf = std::string(render::kBsdfReadingNames[static_cast<size_t>(config.bsdf)]),
                        .config_text = text});

  std::array<Index, 2> indices = {Index(root / "train.jsonl", root, 0, config.train),
                                  Index(root / "test.jsonl", root, config.train, config.test)};
  const auto index_of = [&](int64_t number) -> Index& { return indices[number < config.train ? 0 : 1]; };
  std::vector<int64_t> missing;
  for (int64_t number = 0; number < total; ++number) {
    if (!index_of(number).has(number)) missing.push_back(number);
  }
  GenerateResult result;
  result.kept = total - static_cast<int64_t>(missing.size());
  options.progress(result.kept, total);

  std::mutex mutex;
  parallel_for(static_cast<int64_t>(missing.size()), [&](int64_t i) {
    {
      const std::lock_guard lock(mutex);
      if (options.stop()) return;
    }
    const int64_t number = missing[static_cast<size_t>(i)];
    Rendered made = render_number(config, assets, number);
    const WrittenScene written = write_scene(root, number, made.images, made.record);
    const std::lock_guard lock(mutex);
    index_of(number).add(number, made.record);
    ++result.rendered;
    result.redrawn += made.redrawn;
    result.clamped += written.clamped;
    result.faults.lost += made.faults.lost;
    result.faults.paths += made.faults.paths;
    options.progress(result.kept + result.rendered, total);
  });
  for (const Index& index : indices) index.sort();
  result.skipped = assets.skipped();
  result.complete = result.kept + result.rendered == total;
  return result;
}

}  // namespace opaline
