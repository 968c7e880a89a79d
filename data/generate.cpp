#include "data/generate.h"

#include <fmt/format.h>

#include <algorithm>
#include <chrono>
#include <cmath>
#include <map>
#include <mutex>

#include "core/error.h"
#include "core/file_lock.h"
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
  /// Lines that are torn, point to no file, or are no longer wanted are dropped; whether the files are intact
  /// is for damaged() to tell.
  Index(fs::path path, const fs::path& root, int64_t first, int64_t count) : path_(std::move(path)) {
    if (!fs::exists(path_)) return;
    for (SceneRecord& record : read_scene_index(path_, true)) {
      const int64_t number = number_of(record);
      const bool wanted = number >= first && number < first + count;
      if (wanted && fs::is_regular_file(root / record.file)) records_[number] = std::move(record);
    }
    sort();
  }

  const std::map<int64_t, SceneRecord>& records() const { return records_; }
  bool has(int64_t number) const { return records_.contains(number); }
  void add(int64_t number, const SceneRecord& record) {
    append_scene_record(path_, record);
    records_[number] = record;
  }
  void drop(int64_t number) { records_.erase(number); }
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
                                             .error = config.error,
                                             .dop_error = config.dop_error,
                                             .bsdf = config.bsdf,
                                             .photons = config.photons,
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
    record.spp = static_cast<int64_t>(std::llround(made.spp));
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
  if (!fs::exists(root / "dataset.toml")) return;
  const SceneSetInfo before = read_scene_set_info(root);
  if (before.config_text == text && before.generator_version == kVersion) return;
  fail_usage(root.string(),
             "holds a data set of another config, generator {}:\n{}\nasked for now, generator {}:\n{}\n"
             "Choose another folder, or remove this one",
             before.generator_version, before.config_text, kVersion, text);
}

/// What a killed run was writing (core/file.h). Nobody else writes here while we hold the lock.
void remove_half_written(const fs::path& folder) {
  std::vector<fs::path> found;
  for (const fs::directory_entry& entry : fs::directory_iterator(folder)) {
    const std::string extension = entry.path().stem().extension().string();
    if (extension == ".tmp" && entry.is_regular_file()) found.push_back(entry.path());
  }
  for (const fs::path& path : found) fs::remove(path);
}

/// One run of generate().
class Generation {
 public:
  Generation(const GenerateConfig& config, const AssetFolders& assets, const fs::path& root,
             const GenerateOptions& options)
      : config_(config),
        assets_(assets),
        root_(root),
        options_(options),
        indices_{Index(root / "train.jsonl", root, 0, config.train),
                 Index(root / "test.jsonl", root, config.train, config.test)} {
    result_.kept = present();
  }

  GenerateResult run() {
    for (int round = 0; round < kMostRounds; ++round) {
      render_missing();
      if (present() < total()) break;
      if (verify()) {
        result_.complete = true;
        break;
      }
      if (stopped_) break;
    }
    for (const Index& index : indices_) index.sort();
    result_.skipped = assets_.skipped();
    if (!result_.complete && !stopped_) {
      fail(root_.string(), "files come back damaged after {} attempts to render them: is the disk sound?",
           kMostRounds);
    }
    return result_;
  }

 private:
  // A file that is damaged again after it was just written: the disk is, and more rounds do not help.
  static constexpr int kMostRounds = 3;

  int64_t total() const { return config_.train + config_.test; }
  int64_t present() const {
    return static_cast<int64_t>(indices_[0].records().size() + indices_[1].records().size());
  }
  Index& index_of(int64_t number) { return indices_[number < config_.train ? 0 : 1]; }

  /// Whether to begin another scene; one that failed stops the others, as they would fail alike.
  bool go_on() {
    const std::lock_guard lock(mutex_);
    stopped_ = stopped_ || options_.stop();
    return !stopped_ && !failed_;
  }
  void fail_all() {
    const std::lock_guard lock(mutex_);
    failed_ = true;
  }

  void render_missing() {
    std::vector<int64_t> missing;
    for (int64_t number = 0; number < total(); ++number) {
      if (!index_of(number).has(number)) missing.push_back(number);
    }
    if (missing.empty()) return;
    options_.progress(GenerateStep::kRender, present(), total());
    parallel_for(static_cast<int64_t>(missing.size()), [&](int64_t i) {
      if (!go_on()) return;
      try {
        render_one(missing[static_cast<size_t>(i)]);
      } catch (...) {
        fail_all();
        throw;
      }
    });
  }

  void render_one(int64_t number) {
    Rendered made = render_number(config_, assets_, number);
    const WrittenScene written = write_scene(root_, number, made.images, made.record);
    const std::lock_guard lock(mutex_);
    index_of(number).add(number, made.record);
    ++result_.rendered;
    result_.redrawn += made.redrawn;
    result_.clamped += written.clamped;
    result_.faults.lost += made.faults.lost;
    result_.faults.paths += made.faults.paths;
    options_.progress(GenerateStep::kRender, present(), total());
  }

  /// Reads every file of the index; those whose checksum is wrong are dropped from it. True where all are
  /// right.
  bool verify() {
    std::vector<std::pair<int64_t, const SceneRecord*>> all;
    for (const Index& index : indices_) {
      for (const auto& [number, record] : index.records()) all.emplace_back(number, &record);
    }
    std::vector<int64_t> damaged;
    result_.verified = 0;
    options_.progress(GenerateStep::kVerify, 0, total());
    parallel_for(static_cast<int64_t>(all.size()), [&](int64_t i) {
      if (!go_on()) return;
      const auto& [number, record] = all[static_cast<size_t>(i)];
      const bool intact = scene_is_intact(root_, *record);
      const std::lock_guard lock(mutex_);
      if (!intact) damaged.push_back(number);
      result_.verified += intact ? 1 : 0;
      options_.progress(GenerateStep::kVerify, result_.verified + static_cast<int64_t>(damaged.size()),
                        total());
    });
    for (const int64_t number : damaged) index_of(number).drop(number);
    result_.damaged += static_cast<int64_t>(damaged.size());
    result_.kept = std::max<int64_t>(0, result_.kept - static_cast<int64_t>(damaged.size()));
    return result_.verified == total();
  }

  const GenerateConfig& config_;
  const AssetFolders& assets_;
  const fs::path& root_;
  const GenerateOptions& options_;
  std::array<Index, 2> indices_;
  GenerateResult result_;
  std::mutex mutex_;
  bool stopped_ = false;
  bool failed_ = false;
};

}  // namespace

GenerateResult generate(const GenerateConfig& config, const fs::path& root, const GenerateOptions& options) {
  if (config.train + config.test == 0) {
    fail_usage("render", "no scenes to render: set render.train and render.test");
  }
  const FileLock lock(root / "lock", "is rendering into this folder; wait for it or choose another --out");
  const AssetFolders assets(config.assets, config.seed, config.train > 0, config.test > 0);
  const std::string text = config.text() + assets.text();
  compare_with_existing(text, root);
  std::error_code error;
  fs::create_directories(root / "scenes", error);
  if (error) fail((root / "scenes").string(), "cannot make the folder: {}", error.message());
  remove_half_written(root);
  remove_half_written(root / "scenes");
  write_scene_set_info(root,
                       {.generator_version = std::string(kVersion),
                        .seed = config.seed,
                        .train = config.train,
                        .test = config.test,
                        .width = config.camera.width,
                        .height = config.camera.height,
                        .bsdf = std::string(render::kBsdfReadingNames[static_cast<size_t>(config.bsdf)]),
                        .config_text = text});
  return Generation(config, assets, root, options).run();
}

}  // namespace opaline
