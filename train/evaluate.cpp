#include "train/evaluate.h"

#include <algorithm>
#include <cmath>
#include <set>

#include "core/autograd.h"
#include "core/error.h"
#include "core/parallel.h"

namespace opaline {
namespace {

// Scenes read at once while the mean is formed.
constexpr int64_t kBlock = 32;
// Of the sensor's errors: evaluations of all runs see the same images.
constexpr uint64_t kSensorSeed = 20240917;

/// Image n of a batch, or what there is of it.
std::span<const float> image_of(const Tensor& batch, int64_t n) {
  if (const auto& sites = batch.sites()) {
    const int64_t channels = batch.size(1);
    const int64_t first = sites->first(n);
    return batch.values<float>().subspan(static_cast<size_t>(first * channels),
                                         static_cast<size_t>((sites->first(n + 1) - first) * channels));
  }
  const int64_t size = batch.numel() / batch.size(0);
  return batch.values<float>().subspan(static_cast<size_t>(n * size), static_cast<size_t>(size));
}

std::optional<SssValues> sss_of(const Tensor& batch, int64_t n) {
  if (!batch.defined()) return std::nullopt;
  return decode_sss(image_of(batch, n));
}

/// The mean predictor's maps where image n of a batch has pixels.
class MeanMaps {
 public:
  MeanMaps(const MeanPredictor& mean, const Tensor& batch, int64_t n) : mean_(mean) {
    const auto& sites = batch.sites();
    if (!sites) return;
    for (int64_t row = 0; row < sites->h(); ++row) {
      for (int64_t column = 0; column < sites->w(); ++column) {
        if (sites->site(n, row, column) < 0) continue;
        const int64_t pixel = row * sites->w() + column;
        normal_.insert(normal_.end(), mean.normal.begin() + 3 * pixel, mean.normal.begin() + 3 * pixel + 3);
        depth_.push_back(mean.depth[static_cast<size_t>(pixel)]);
      }
    }
    part_ = true;
  }
  SceneValues values(const EvaluateColumns& columns) const {
    SceneValues result{.normal = {}, .depth = {}, .sss = {}};
    if (columns.normal) result.normal = part_ ? normal_ : mean_.normal;
    if (columns.depth) result.depth = part_ ? depth_ : mean_.depth;
    if (columns.sss) result.sss = mean_.sss;
    return result;
  }

 private:
  const MeanPredictor& mean_;
  std::vector<float> normal_, depth_;
  bool part_ = false;
};

void require_finite(const Metrics& metrics, const std::string& id) {
  for (size_t m = 0; m < kMetricCount; ++m) {
    if (metrics[m] && !std::isfinite(*metrics[m])) {
      fail("evaluate", "scene {}: the {} error is {}; are the weights sound?", id, kMetricNames[m],
           *metrics[m]);
    }
  }
}

/// Sums over scenes, added in scene order so that threads change nothing.
struct MeanSums {
  std::vector<double> normal, depth, count;
  std::array<double, 7> sss{};
  double all_depth = 0.0;
  double all_count = 0.0;
  int64_t scenes = 0;
  bool has_sss = true;

  void add(const Scene& scene) {
    for (size_t i = 0; i < scene.mask.size(); ++i) {
      if (scene.mask[i] == 0) continue;
      for (size_t c = 0; c < 3; ++c) normal[3 * i + c] += scene.normal[3 * i + c];
      depth[i] += scene.depth[i];
      count[i] += 1.0;
      all_depth += scene.depth[i];
      all_count += 1.0;
    }
    ++scenes;
    has_sss = has_sss && scene.g && scene.sigma_t && scene.albedo;
    if (!has_sss) return;
    sss[0] += *scene.g;
    for (size_t c = 0; c < 3; ++c) {
      sss[1 + c] += (*scene.sigma_t)[c];
      sss[4 + c] += (*scene.albedo)[c];
    }
  }

  MeanPredictor mean(int width, int height) const {
    MeanPredictor result{.width = width, .height = height, .normal = {}, .depth = {}, .sss = {}};
    const size_t pixels = count.size();
    result.normal.resize(3 * pixels);
    result.depth.resize(pixels);
    for (size_t i = 0; i < pixels; ++i) {
      const double length = std::sqrt(normal[3 * i] * normal[3 * i] + normal[3 * i + 1] * normal[3 * i + 1] +
                                      normal[3 * i + 2] * normal[3 * i + 2]);
      for (size_t c = 0; c < 3; ++c) {
        const double fallback = c == 2 ? 1.0 : 0.0;
        result.normal[3 * i + c] = static_cast<float>(length > 0.0 ? normal[3 * i + c] / length : fallback);
      }
      const double sum = count[i] > 0.0 ? depth[i] / count[i] : all_depth / std::max(1.0, all_count);
      result.depth[i] = static_cast<float>(sum);
    }
    if (has_sss) {
      const auto value = [&](size_t i) { return static_cast<float>(sss[i] / static_cast<double>(scenes)); };
      result.sss = SssValues{
          .g = value(0), .sigma_t = {value(1), value(2), value(3)}, .albedo = {value(4), value(5), value(6)}};
    }
    return result;
  }
};

nlohmann::ordered_json number_or_null(const std::optional<double>& value) {
  return value ? nlohmann::ordered_json(*value) : nlohmann::ordered_json();
}

/// The layout that metrics, intervals and the mean predictor share.
template <class Value>
nlohmann::ordered_json arrange(const Value& value) {
  nlohmann::ordered_json json;
  for (size_t m = 0; m < kReleaseMetricCount; ++m) json["release"][std::string(kMetricNames[m])] = value(m);
  for (size_t m = kReleaseMetricCount; m < kMetricCount; ++m) json[std::string(kMetricNames[m])] = value(m);
  return json;
}

}  // namespace

EvaluateColumns parse_columns(std::span<const std::string> names) {
  if (names.empty()) return {};
  EvaluateColumns columns{.normal = false, .depth = false, .sss = false};
  for (const std::string& name : names) {
    if (name == "normal") {
      columns.normal = true;
    } else if (name == "depth") {
      columns.depth = true;
    } else if (name == "sss") {
      columns.sss = true;
    } else {
      fail_usage("evaluate", "there are no columns '{}'; there are {}", name, fmt::join(kColumnNames, ", "));
    }
  }
  return columns;
}

MeanPredictor fit_mean_predictor(const Dataset& dataset, int64_t max_scenes, DamagePolicy damaged) {
  const int64_t all = dataset.size(Split::kTrain);
  const std::string where = dataset.facts().root.string();
  if (all == 0) fail(where, "has no training scenes to take the mean of");
  const int64_t n = max_scenes > 0 ? std::min(all, max_scenes) : all;
  MeanSums sums;
  int width = 0;
  int height = 0;
  for (int64_t begin = 0; begin < n; begin += kBlock) {
    std::vector<Scene> scenes(static_cast<size_t>(std::min(kBlock, n - begin)));
    parallel_for(static_cast<int64_t>(scenes.size()), [&](int64_t i) {
      const int64_t index = (begin + i) * all / n;
      try {
        scenes[static_cast<size_t>(i)] = dataset.load(Split::kTrain, index, {.bsdf = false, .whole = false});
      } catch (const Error&) {
        if (damaged == DamagePolicy::kFail) throw;
      }
    });
    for (const Scene& scene : scenes) {
      if (scene.mask.empty()) continue;  // damaged
      if (scene.normal.empty() || scene.depth.empty()) {
        fail(where, "training scene {} has no ground truth of normal and depth", scene.id);
      }
      if (sums.scenes == 0) {
        width = scene.width;
        height = scene.height;
        const auto pixels = static_cast<size_t>(scene.pixels());
        sums.normal.resize(3 * pixels);
        sums.depth.resize(pixels);
        sums.count.resize(pixels);
      }
      if (scene.width != width || scene.height != height) {
        fail(where, "training scene {} is {} x {}, those before it {} x {}: there is no mean map of both",
             scene.id, scene.width, scene.height, width, height);
      }
      sums.add(scene);
    }
  }
  if (sums.scenes == 0) fail(where, "none of {} training scenes can be read", n);
  return sums.mean(width, height);
}

std::vector<SceneResult> evaluate(Cascade& cascade, const std::shared_ptr<const Dataset>& dataset,
                                  const EncodeOptions& encode, const MeanPredictor* mean,
                                  const EvaluateOptions& options) {
  Loader loader(
      dataset,
      {.split = options.split,
       .batch = options.batch,
       .min_last = 1,
       .shuffle = false,
       .seed = kSensorSeed,
       .epochs = 1,
       .max_samples = options.max_scenes,
       .threads = options.threads,
       .damaged = options.damaged,
       .capture = options.capture,
       .encode = encode,
       .wanted = {.targets = true, .reconstruction = false, .support = cascade.options().support()}});
  const NoGradGuard no_grad;
  cascade.set_training(false);
  const EvaluateColumns& columns = options.columns;
  const bool sss = columns.sss && cascade.options().stage == 2;
  std::vector<SceneResult> results;
  while (const std::optional<Batch> batch = loader.next()) {
    if (!batch->normal.defined() || !batch->depth.defined()) {
      fail("evaluate", "scene {} has no ground truth of normal and depth", batch->ids.front());
    }
    const CascadeOutput out = cascade.forward(
        {.image = batch->input, .bsdf = {}, .mask = batch->mask},
        {.normal = columns.normal, .depth = columns.depth, .illumination = false, .sss = sss});
    std::set<int64_t> left_out;  // a stand-in is another test scene: it must not count twice
    for (const ReplacedScene& scene : batch->replaced) {
      left_out.insert(scene.sample);
      if (options.warn) options.warn(fmt::format("scene {} is left out: {}", scene.id, scene.what));
    }
    for (int64_t n = 0; n < batch->size(); ++n) {
      if (left_out.contains(n)) continue;
      const SceneValues truth{.normal = image_of(batch->normal, n),
                              .depth = image_of(batch->depth, n),
                              .sss = sss_of(batch->sss, n)};
      SceneValues estimate{.normal = {}, .depth = {}, .sss = sss_of(out.sss, n)};
      if (columns.normal) estimate.normal = image_of(out.normal, n);
      if (columns.depth) estimate.depth = image_of(out.depth, n);
      const std::span<const float> mask = image_of(batch->mask, n);
      SceneResult result;
      result.id = batch->ids[static_cast<size_t>(n)];
      result.sss_estimate = estimate.sss;
      result.sss_truth = truth.sss;
      result.cascade = measure(estimate, truth, mask);
      require_finite(result.cascade, result.id);
      if (mean != nullptr) {
        const int64_t width = batch->input.size(2);
        const int64_t height = batch->input.size(1);
        if (mean->width != width || mean->height != height) {
          fail("evaluate", "scene {} is {} x {}, the training scenes {} x {}: the mean map does not fit",
               result.id, width, height, mean->width, mean->height);
        }
        result.mean = measure(MeanMaps(*mean, batch->mask, n).values(columns), truth, mask);
      }
      results.push_back(std::move(result));
    }
  }
  return results;
}

EvaluationSummary summarize(const std::vector<SceneResult>& results) {
  std::vector<Metrics> cascade, mean;
  for (const SceneResult& result : results) {
    cascade.push_back(result.cascade);
    mean.push_back(result.mean);
  }
  EvaluationSummary summary;
  summary.n = static_cast<int64_t>(results.size());
  summary.cascade = mean_metrics(cascade);
  summary.mean_predictor = mean_metrics(mean);
  for (size_t m = 0; m < kMetricCount; ++m) {
    if (!summary.cascade[m]) continue;
    std::vector<double> values;
    for (const Metrics& metrics : cascade) values.push_back(metrics[m].value_or(0.0));
    summary.ci95[m] = bootstrap_interval(values);
  }
  return summary;
}

nlohmann::ordered_json to_json(const Metrics& metrics) {
  return arrange([&](size_t m) { return number_or_null(metrics[m]); });
}

nlohmann::ordered_json to_json(const EvaluationSummary& summary) {
  nlohmann::ordered_json json = {{"n", summary.n}};
  json.update(to_json(summary.cascade));
  json["ci95"] = arrange([&](size_t m) {
    const auto& interval = summary.ci95[m];
    return interval ? nlohmann::ordered_json::array({interval->low, interval->high})
                    : nlohmann::ordered_json();
  });
  json["mean_predictor"] = to_json(summary.mean_predictor);
  return json;
}

std::string format_table(const EvaluationSummary& summary) {
  const auto row = [](std::string_view name, const auto& cell) {
    std::string line = fmt::format("{:<16}", name);
    for (size_t m = 0; m < kMetricCount; ++m) line += fmt::format("{:>17}", cell(m));
    return line + "\n";
  };
  const auto number = [](size_t m, double value) {
    return m == static_cast<size_t>(Metric::kAngularDegrees) ? fmt::format("{:.2f}", value)
                                                             : fmt::format("{:.4f}", value);
  };
  const auto metric = [&](const Metrics& metrics) {
    return [&, metrics](size_t m) { return metrics[m] ? number(m, *metrics[m]) : std::string("-"); };
  };
  std::string table = row(fmt::format("{} scenes", summary.n), [](size_t m) { return kMetricNames[m]; });
  table += row("cascade", metric(summary.cascade));
  table += row("  95 % interval", [&](size_t m) {
    const auto& interval = summary.ci95[m];
    return interval ? number(m, interval->low) + " .. " + number(m, interval->high) : std::string("-");
  });
  table += row("training mean", metric(summary.mean_predictor));
  return table;
}

}  // namespace opaline
