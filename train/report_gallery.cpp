#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>

#include "core/autograd.h"
#include "data/chart.h"
#include "data/page.h"
#include "data/picture.h"
#include "train/report_parts.h"

namespace opaline::report {
namespace {

// Ends of the colour scales: fixed, so that reports can be compared.
constexpr float kAngleScale = 60.0F;  // degrees
constexpr float kDepthScale = 0.2F;   // half-widths of the cube

/// Angle in degrees at each pixel.
std::vector<float> angles(std::span<const float> estimate, std::span<const float> truth) {
  std::vector<float> result(truth.size() / 3);
  const std::vector<float> one = {1.0F};
  for (size_t i = 0; i < result.size(); ++i) {
    result[i] =
        static_cast<float>(mean_angle_degrees(estimate.subspan(3 * i, 3), truth.subspan(3 * i, 3), one));
  }
  return result;
}

/// The estimate after the scale and shift that fit the truth best inside the mask.
std::vector<float> aligned(std::span<const float> estimate, std::span<const float> truth,
                           std::span<const uint8_t> mask) {
  double n = 0.0, sx = 0.0, sy = 0.0, sxx = 0.0, sxy = 0.0;
  for (size_t i = 0; i < mask.size(); ++i) {
    if (mask[i] == 0) continue;
    const double x = estimate[i];
    n += 1.0;
    sx += x;
    sy += truth[i];
    sxx += x * x;
    sxy += x * truth[i];
  }
  const double var = sxx - sx * sx / std::max(1.0, n);
  const double scale = var > 0.0 ? (sxy - sx * sy / n) / var : 0.0;
  const double shift = n > 0.0 ? (sy - scale * sx) / n : 0.0;
  std::vector<float> result(mask.size());
  for (size_t i = 0; i < mask.size(); ++i) result[i] = static_cast<float>(scale * estimate[i] + shift);
  return result;
}

std::string triple(const std::array<float, 3>& values, int digits) {
  return fmt::format("{0:.{3}f} {1:.{3}f} {2:.{3}f}", values[0], values[1], values[2], digits);
}

std::string parameters(const SceneResult& result) {
  if (!result.sss_truth) return {};
  const auto estimate = [&](const auto& text) {
    return result.sss_estimate ? text(*result.sss_estimate) : "-";
  };
  const auto row = [&](std::string_view name, const auto& text) {
    return fmt::format("<tr><td>{}</td><td>{}</td><td>{}</td></tr>", name, text(*result.sss_truth),
                       estimate(text));
  };
  return "<table class='small'><tr><th></th><th>truth</th><th>estimate</th></tr>" +
         row("sigma_t", [](const SssValues& v) { return triple(v.sigma_t, 1); }) +
         row("albedo", [](const SssValues& v) { return triple(v.albedo, 2); }) +
         row("g", [](const SssValues& v) { return fmt::format("{:.2f}", v.g); }) + "</table>";
}

std::string scene_row(const Scene& scene, const CascadeOutput& out, const SceneResult& result) {
  const auto map = [&](std::span<const float> values) {
    return MaskedMap{.values = values, .mask = scene.mask, .width = scene.width, .height = scene.height};
  };
  const std::span<const float> normal = std::as_const(out.normal).values<float>();
  const std::vector<float> angle = angles(normal, scene.normal);
  const std::vector<float> depth = aligned(std::as_const(out.depth).values<float>(), scene.depth, scene.mask);
  std::vector<float> depth_error(depth.size());
  for (size_t i = 0; i < depth.size(); ++i) depth_error[i] = std::abs(depth[i] - scene.depth[i]);
  const ValueRange range = range_inside(map(scene.depth));

  const auto value = [&](Metric metric) { return result.cascade[static_cast<size_t>(metric)].value_or(0.0); };
  std::string html = fmt::format("<div class='scene'><div class='facts'><b>{}</b>", escape_html(result.id));
  html += fmt::format("<br>{:.1f} degrees<br>depth {:.3f}{}</div>", value(Metric::kAngularDegrees),
                      value(Metric::kDepthAligned), parameters(result));
  html += html_figure(picture_of_input(scene), "input");
  html += html_figure(picture_of_normals(map(scene.normal)), "normal, truth");
  html += html_figure(picture_of_normals(map(normal)), "normal, predicted");
  html += html_figure(picture_of_error(map(angle), kAngleScale), "angle between");
  html += html_figure(picture_of_depth(map(scene.depth), range.low, range.high), "depth, truth");
  html += html_figure(picture_of_depth(map(depth), range.low, range.high), "depth, aligned");
  html += html_figure(picture_of_error(map(depth_error), kDepthScale), "difference");
  return html + "</div>";
}

std::string legend(std::string_view name, double high, std::string_view unit) {
  std::string stops;
  for (int i = 0; i <= 5; ++i) {
    const auto rgb = heat_colour(i / 5.0);
    stops += fmt::format("{}rgb({},{},{})", i == 0 ? "" : ",", rgb[0], rgb[1], rgb[2]);
  }
  return fmt::format(
      "<span class='legend'>{} 0 <i style='background:linear-gradient(90deg,{})'></i> {}{}</span>", name,
      stops, high, unit);
}

}  // namespace

std::string gallery(const TrainedModel& model, const Dataset& dataset,
                    const std::vector<SceneResult>& results, int64_t count) {
  std::vector<size_t> order(results.size());
  std::iota(order.begin(), order.end(), size_t{0});
  constexpr auto kAngle = static_cast<size_t>(Metric::kAngularDegrees);
  std::stable_sort(order.begin(), order.end(), [&](size_t a, size_t b) {
    return results[a].cascade[kAngle] < results[b].cascade[kAngle];
  });
  const size_t n = std::min(order.size(), static_cast<size_t>(std::max<int64_t>(0, count)));

  std::string html =
      "<p>" + legend("angle", kAngleScale, " degrees") +
      legend("depth difference", static_cast<double>(std::lround(100.0F * kDepthScale)) / 100.0, "") + "</p>";
  const NoGradGuard no_grad;
  model.cascade->set_training(false);
  const bool sss = model.cascade->has("sss");
  for (size_t k = 0; k < n; ++k) {
    // From the best to the worst, both included.
    const size_t index = order[n > 1 ? k * (order.size() - 1) / (n - 1) : 0];
    const Scene scene = dataset.load(Split::kTest, static_cast<int64_t>(index), {.bsdf = false});
    const Sample sample =
        encode_scene(scene, model.config.model.encode, {.targets = false, .reconstruction = false});
    const Batch batch = make_batch({&sample, 1});
    const CascadeOutput out = whole(model.cascade->forward(
        {.image = batch.input, .bsdf = {}, .mask = batch.mask}, {.illumination = false, .sss = sss}));
    html += scene_row(scene, out, results[index]);
  }
  return html;
}

}  // namespace opaline::report
