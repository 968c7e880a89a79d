// What a data set of ours promises besides its scenes.
#include <fmt/format.h>

#include <set>

#include "data/check_parts.h"
#include "data/scene_set.h"

namespace opaline {
namespace {

namespace fs = std::filesystem;

/// Names that stand for no particular thing.
bool is_name(const std::string& text) {
  return !text.empty() && text != "none";
}

struct SplitNames {
  std::set<std::string> objects;
  std::set<std::string> environments;
};

/// A line's box and coverage (of A > 0) against the mask (A = 1) of its file.
void compare_with_mask(const SceneRecord& record, SceneCheck& scene) {
  if (!scene.read || !(scene.coverage > 0)) return;
  const Window& mask = scene.box;
  const Window& box = record.box;
  if (mask.x0 < box.x0 || mask.y0 < box.y0 || mask.x1 > box.x1 || mask.y1 > box.y1) {
    scene.problems.push_back(fmt::format("the index says its box is {}, its mask reaches over {}",
                                         to_string(box), to_string(mask)));
  }
  constexpr double kRounding = 1e-3;
  if (!(scene.coverage <= record.coverage + kRounding)) {
    scene.problems.push_back(
        fmt::format("the index says it covers {:.4f} of the image, its mask covers {:.4f}", record.coverage,
                    scene.coverage));
  }
}

/// An object or environment of training scenes that test scenes have as well: test errors would be too small.
void check_disjoint(std::string_view what, const std::set<std::string>& train,
                    const std::set<std::string>& test, bool promised, DatasetCheck& check) {
  std::vector<std::string> shared;
  for (const std::string& name : test) {
    if (train.contains(name)) shared.push_back(name);
  }
  if (train.empty() || test.empty()) return;
  const std::string found =
      shared.empty() ? fmt::format("{} in training, {} others in test scenes", train.size(), test.size())
                     : fmt::format("{} of both splits, such as {}", shared.size(), shared.front());
  const Verdict verdict = shared.empty() ? Verdict::kGood : promised ? Verdict::kBad : Verdict::kWarning;
  judge(check, {std::string(what), "disjoint", found, verdict});
}

}  // namespace

void check_scene_set(const Dataset& dataset, DatasetCheck& check) {
  const fs::path& root = check.facts.root;
  const SceneSetInfo info = read_scene_set_info(root);
  const size_t before = check.problems.size();
  std::set<std::string> known;
  std::array<SplitNames, 2> names;
  for (const Split split : {Split::kTrain, Split::kTest}) {
    const int64_t promised = split == Split::kTrain ? info.train : info.test;
    if (dataset.size(split) != promised) {
      check.problems.push_back(fmt::format("dataset.toml promises {} {} scenes, {}.jsonl lists {}", promised,
                                           to_string(split), to_string(split), dataset.size(split)));
    }
    const fs::path index = root / fmt::format("{}.jsonl", to_string(split));
    if (!fs::exists(index)) continue;
    const std::vector<SceneRecord> records = read_scene_index(index);
    for (SplitCheck& checked : check.splits) {
      for (size_t i = 0; checked.split == split && i < checked.scenes.size() && i < records.size(); ++i) {
        compare_with_mask(records[i], checked.scenes[i]);
      }
    }
    for (const SceneRecord& record : records) {
      if (!known.insert(record.file).second) {
        check.problems.push_back(fmt::format("{} is listed more than once", record.file));
      }
      SplitNames& mine = names[split == Split::kTrain ? 0 : 1];
      if (is_name(record.object)) mine.objects.insert(record.object);
      if (is_name(record.environment)) mine.environments.insert(record.environment);
    }
  }
  int64_t unlisted = 0;
  if (fs::is_directory(root / "scenes")) {
    for (const fs::directory_entry& entry : fs::directory_iterator(root / "scenes")) {
      unlisted += known.contains("scenes/" + entry.path().filename().string()) ? 0 : 1;
    }
  }
  if (unlisted > 0) {
    check.warnings.push_back(fmt::format("scenes/ has {} files that no index lists", unlisted));
  }
  const size_t wrong = check.problems.size() - before;
  check.findings.push_back(
      {"index", fmt::format("{} training, {} test scenes", info.train, info.test),
       fmt::format("{} files, {} disagreements, {} files not listed", known.size(), wrong, unlisted),
       wrong > 0      ? Verdict::kBad
       : unlisted > 0 ? Verdict::kWarning
                      : Verdict::kGood});
  // What we render has objects and rooms of its own in each scene; other makers may have chosen otherwise.
  const bool promised = info.generator == "opaline";
  check_disjoint("objects of the splits", names[0].objects, names[1].objects, promised, check);
  check_disjoint("environments of the splits", names[0].environments, names[1].environments, promised, check);
}

}  // namespace opaline
