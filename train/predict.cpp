#include "train/predict.h"

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>

#include "core/autograd.h"
#include "core/error.h"
#include "core/file.h"
#include "data/encode.h"
#include "data/exr.h"
#include "data/picture.h"
#include "data/scene_set.h"
#include "nn/state.h"
#include "train/fit_scene.h"

namespace opaline {
namespace {

namespace fs = std::filesystem;

constexpr size_t kShPerColour = 9;

std::string folder_name(const std::string& id) {
  std::string name = id;
  std::replace(name.begin(), name.end(), '/', '_');
  return name.empty() || name.starts_with('.') ? "scene" + name : name;
}

/// One scene's file of our data set: which of the splits has it says the index.
PredictInput find_scene_file(const fs::path& file) {
  const fs::path root = fs::absolute(file).lexically_normal().parent_path().parent_path();
  std::shared_ptr<const Dataset> dataset = open_scene_set(root);
  const std::string relative = fs::absolute(file).lexically_normal().lexically_relative(root).string();
  for (const Split split : {Split::kTest, Split::kTrain}) {
    const fs::path index = root / (std::string(to_string(split)) + ".jsonl");
    if (!fs::exists(index)) continue;
    for (const SceneRecord& record : read_scene_index(index)) {
      if (record.file != relative) continue;
      for (int64_t i = 0; i < dataset->size(split); ++i) {
        if (dataset->id(split, i) == record.id) return {dataset, split, i, folder_name(record.id)};
      }
    }
  }
  fail(file.string(), "is in no index of the data set {}", root.string());
}

/// The maps of one prediction, zero outside the mask; empty where not asked for.
struct Maps {
  std::vector<float> normal;  // unit length
  std::vector<float> depth;
};

Maps masked_maps(const CascadeOutput& out, const Scene& scene, const PredictWanted& wanted) {
  Maps maps;
  const auto pixels = static_cast<size_t>(scene.pixels());
  if (wanted.normal) {
    maps.normal.resize(3 * pixels);
    const std::span<const float> n = std::as_const(out.normal).values<float>();
    for (size_t i = 0; i < pixels; ++i) {
      if (scene.mask[i] == 0) continue;
      const float length =
          std::sqrt(n[3 * i] * n[3 * i] + n[3 * i + 1] * n[3 * i + 1] + n[3 * i + 2] * n[3 * i + 2]);
      for (size_t c = 3 * i; c < 3 * i + 3; ++c) maps.normal[c] = n[c] / std::max(length, 1e-12F);
    }
  }
  if (wanted.depth) {
    maps.depth.resize(pixels);
    const std::span<const float> d = std::as_const(out.depth).values<float>();
    for (size_t i = 0; i < pixels; ++i) maps.depth[i] = scene.mask[i] != 0 ? d[i] : 0.0F;
  }
  return maps;
}

void write_maps(const Maps& maps, const Scene& scene, const fs::path& folder) {
  const auto pixels = static_cast<size_t>(scene.pixels());
  ExrPart part;
  part.window = {.x0 = 0, .y0 = 0, .x1 = scene.width, .y1 = scene.height};
  part.half = false;
  if (!maps.normal.empty()) part.channels.insert(part.channels.end(), {"normal.X", "normal.Y", "normal.Z"});
  if (!maps.depth.empty()) part.channels.emplace_back("depth.Z");
  part.channels.emplace_back("mask.A");
  part.pixels.reserve(pixels * part.channels.size());
  for (size_t i = 0; i < pixels; ++i) {
    if (!maps.normal.empty()) {
      for (size_t c = 3 * i; c < 3 * i + 3; ++c) part.pixels.push_back(maps.normal[c]);
    }
    if (!maps.depth.empty()) part.pixels.push_back(maps.depth[i]);
    part.pixels.push_back(static_cast<float>(scene.mask[i]));
  }
  write_exr(folder / "prediction.exr",
            {.width = scene.width, .height = scene.height, .parts = {std::move(part)}});

  const auto map = [&](const std::vector<float>& values) {
    return MaskedMap{.values = values, .mask = scene.mask, .width = scene.width, .height = scene.height};
  };
  if (!maps.normal.empty()) write_picture(folder / "normal.png", picture_of_normals(map(maps.normal)));
  if (!maps.depth.empty()) {
    const ValueRange range = range_inside(map(maps.depth));
    write_picture(folder / "depth.png", picture_of_depth(map(maps.depth), range.low, range.high));
  }
}

nlohmann::ordered_json sss_json(const SssValues& sss, bool with_flash) {
  nlohmann::ordered_json json = {{"g", sss.g}, {"sigma_t", sss.sigma_t}, {"albedo", sss.albedo}};
  if (with_flash) json["flash"] = sss.flash;
  return json;
}

nlohmann::ordered_json illumination_json(std::span<const float> values, bool with_flash) {
  nlohmann::ordered_json sh = nlohmann::ordered_json::array();
  for (size_t colour = 0; colour < 3; ++colour) {
    const std::span<const float> nine = values.subspan(colour * kShPerColour, kShPerColour);
    sh.push_back(std::vector<float>(nine.begin(), nine.end()));
  }
  nlohmann::ordered_json json = {{"sh", sh}};
  if (with_flash) json["flash"] = unmap_flash(values[3 * kShPerColour]);
  return json;
}

}  // namespace

PredictWanted parse_wanted(const std::vector<std::string>& names) {
  if (names.empty()) return {};
  PredictWanted wanted{.normal = false, .depth = false, .illumination = false, .sss = false};
  for (const std::string& name : names) {
    if (name == "normal") {
      wanted.normal = true;
    } else if (name == "depth") {
      wanted.depth = true;
    } else if (name == "illumination") {
      wanted.illumination = true;
    } else if (name == "sss") {
      wanted.sss = true;
    } else {
      fail_usage("predict", "--only {}: there are normal, depth, illumination and sss", name);
    }
  }
  return wanted;
}

std::vector<std::string> networks_for(const PredictWanted& wanted) {
  if (wanted.sss) return {"normal", "depth", "illumination", "illumination_decoder", "sss"};
  std::vector<std::string> names;
  if (wanted.normal) names.emplace_back("normal");
  if (wanted.depth) names.emplace_back("depth");
  if (wanted.illumination) names.emplace_back("illumination");
  return names;
}

std::vector<PredictInput> open_predict_input(const fs::path& path) {
  if (!fs::exists(path)) fail_usage("predict", "there is no {}", path.string());
  if (fs::is_regular_file(path)) {
    if (path.extension() == ".exr") return {find_scene_file(path)};
    fail_usage("predict", "{} is neither a folder nor an EXR scene of a data set", path.string());
  }
  const std::shared_ptr<const Dataset> dataset = open_dataset(path);
  std::vector<PredictInput> inputs;
  for (int64_t i = 0; i < dataset->size(Split::kTest); ++i) {
    inputs.push_back({dataset, Split::kTest, i, folder_name(dataset->id(Split::kTest, i))});
  }
  if (inputs.empty()) fail(path.string(), "has no scenes to predict on");
  return inputs;
}

fs::path predict(const TrainedModel& model, const PredictInput& input, const PredictOptions& options,
                 const fs::path& out) {
  const Scene scene =
      fit_scene(input.dataset->load(input.split, input.index, {.bsdf = false, .truth = false}), options.size);
  const Sample sample =
      encode_scene(scene, model.config.model.encode, {.targets = false, .reconstruction = false});
  const Batch batch = make_batch({&sample, 1});
  PredictWanted wanted = options.wanted;
  wanted.sss = wanted.sss && model.cascade->has("sss");

  const NoGradGuard no_grad;
  const CascadeOutput result = whole(model.cascade->forward(
      {.image = batch.input, .bsdf = {}, .mask = batch.mask}, {.normal = wanted.normal,
                                                               .depth = wanted.depth,
                                                               .illumination = wanted.illumination,
                                                               .sss = wanted.sss,
                                                               .reconstruction = false}));
  for (const Tensor* tensor : {&result.normal, &result.depth, &result.illumination, &result.sss}) {
    if (tensor->defined() && !all_finite(*tensor)) {
      fail("predict", "scene {}: the result is not finite; are the weights sound?", scene.id);
    }
  }

  const fs::path folder = out / input.name;
  fs::create_directories(folder);
  write_picture(folder / "input.png", picture_of_input(scene));
  if (wanted.normal || wanted.depth) write_maps(masked_maps(result, scene, wanted), scene, folder);

  const EncodeOptions& encode = model.config.model.encode;
  nlohmann::ordered_json json = {{"scene", scene.id},
                                 {"source", scene.source},
                                 {"checkpoint", model.checkpoint.filename().string()},
                                 {"width", scene.width},
                                 {"height", scene.height}};
  if (scene.pair_ratio) json["pair_ratio"] = *scene.pair_ratio;
  if (wanted.sss) json["sss"] = sss_json(decode_sss(result.sss.values<float>()), encode.flash_in_sss);
  if (wanted.illumination) {
    json["illumination"] =
        illumination_json(result.illumination.values<float>(), encode.flash_in_illumination);
  }
  nlohmann::ordered_json notes = {
      {"normal", "camera axes: x right, y up, z towards the camera; unit length"},
      {"depth", "z / 0.25 m in the training scenes; larger is nearer"},
      {"sigma_t", "per metre, at the scale of the training scenes (a cube of 0.5 m)"}};
  if (wanted.illumination || encode.flash_in_sss) {
    notes["exposure"] =
        "SH coefficients and flash are relative to the exposure, which a capture does not tell";
  }
  json["notes"] = notes;
  write_file_atomically(folder / "prediction.json", json.dump(2) + "\n");
  return folder;
}

}  // namespace opaline
