#include <algorithm>
#include <cmath>
#include <map>

#include "core/progress.h"
#include "data/chart.h"
#include "train/report_parts.h"

namespace opaline::report {
namespace {

using Json = nlohmann::json;

constexpr size_t kMostPoints = 400;
const char* const kBlue = "#2563a8";
const char* const kOrange = "#d9731a";

bool is(const Json& event, std::string_view kind) {
  return event.value("event", "") == kind;
}

/// Neighbouring points averaged, so that long runs stay light and readable.
std::vector<ChartPoint> thin(const std::vector<ChartPoint>& points) {
  if (points.size() <= kMostPoints) return points;
  std::vector<ChartPoint> result;
  for (size_t i = 0; i < kMostPoints; ++i) {
    const size_t begin = i * points.size() / kMostPoints;
    const size_t end = (i + 1) * points.size() / kMostPoints;
    ChartPoint sum;
    for (size_t k = begin; k < end; ++k) {
      sum.x += points[k].x;
      sum.y += points[k].y;
    }
    const auto n = static_cast<double>(end - begin);
    result.push_back({sum.x / n, sum.y / n});
  }
  return result;
}

std::vector<ChartPoint> column(const std::vector<Json>& events, std::string_view kind,
                               const nlohmann::json::json_pointer& value) {
  std::vector<ChartPoint> points;
  for (const Json& event : events) {
    if (!is(event, kind) || !event.contains(value) || !event.at(value).is_number()) continue;
    points.push_back({event.value("step", 0.0), event.at(value).get<double>()});
  }
  return points;
}

/// Step of each change of stage.
std::vector<double> stage_changes(const std::vector<Json>& events) {
  std::vector<double> marks;
  double step = 0.0;
  for (const Json& event : events) {
    if (is(event, "stage") && event.value("stage", 1) > 1) marks.push_back(step);
    step = event.value("step", step);
  }
  return marks;
}

}  // namespace

std::string curves(const std::vector<Json>& events, const std::optional<EvaluationSummary>& summary) {
  const std::vector<double> marks = stage_changes(events);
  const auto pointer = [](const std::string& path) { return nlohmann::json::json_pointer(path); };
  std::string html =
      marks.empty() ? "" : "<p class='sub'>The dashed vertical is the change from stage 1 to stage 2.</p>";
  html += "<div class='charts'>";

  const auto loss_chart = [&](const std::string& name, const std::string& title) {
    const auto steps = thin(column(events, "step", pointer("/losses/" + name)));
    const auto epochs = column(events, "epoch", pointer("/losses/" + name));
    if (steps.empty() && epochs.empty()) return std::string();
    return render_chart({{.name = "step", .colour = "#a9c4e0", .points = steps},
                         {.name = "epoch mean", .colour = kBlue, .points = epochs, .markers = true}},
                        {.title = title, .x_label = "step", .log_y = true, .x_marks = marks});
  };
  html += loss_chart("total", "Loss, weighted sum");
  for (const std::string_view name : kLossNames) {
    html += loss_chart(std::string(name), "Loss of " + std::string(name));
  }

  const auto test_chart = [&](Metric metric, const std::string& path, const std::string& title) {
    const auto points = column(events, "eval", pointer(path));
    if (points.empty()) return std::string();
    ChartOptions options{.title = title, .x_label = "step", .x_marks = marks};
    if (summary) {
      options.reference = summary->mean_predictor[static_cast<size_t>(metric)];
      options.reference_name = "training mean";
    }
    return render_chart({{.name = "test", .colour = kOrange, .points = points, .markers = true}}, options);
  };
  html += test_chart(Metric::kAngularDegrees, "/angular_degrees", "Test: mean normal angle, degrees");
  html += test_chart(Metric::kDepthAligned, "/depth_aligned", "Test: depth, aligned");
  html += test_chart(Metric::kSigmaT, "/release/sigma_t", "Test: sigma_t");
  html += test_chart(Metric::kAlbedo, "/release/albedo", "Test: albedo");
  html += test_chart(Metric::kG, "/release/g", "Test: g");

  const auto plain = [&](const std::string& path, const std::string& title, bool log) {
    return render_chart(
        {{.name = "", .colour = kBlue, .points = thin(column(events, "step", pointer(path)))}},
        {.title = title, .x_label = "step", .log_y = log, .x_marks = marks});
  };
  html += plain("/learning_rate", "Learning rate", false);
  html += plain("/gradient_norm", "Norm of the gradient", true);
  html += plain("/wall/images_per_second", "Images per second", false);
  return html + "</div>";
}

std::string scatter(const std::vector<SceneResult>& results) {
  std::vector<ChartPoint> sigma, albedo, g;
  for (const SceneResult& result : results) {
    if (!result.sss_estimate || !result.sss_truth) continue;
    g.push_back({result.sss_truth->g, result.sss_estimate->g});
    for (size_t c = 0; c < 3; ++c) {
      sigma.push_back({result.sss_truth->sigma_t[c], result.sss_estimate->sigma_t[c]});
      albedo.push_back({result.sss_truth->albedo[c], result.sss_estimate->albedo[c]});
    }
  }
  if (g.empty()) return {};
  const auto chart = [](const std::string& title, std::vector<ChartPoint> points) {
    return render_chart(
        {{.name = "", .colour = kBlue, .points = std::move(points)}},
        {.title = title, .x_label = "truth", .lines = false, .diagonal = true, .width = 396, .height = 360});
  };
  return "<div class='charts'>" + chart("sigma_t per metre: estimate over truth", std::move(sigma)) +
         chart("albedo: estimate over truth", std::move(albedo)) +
         chart("g: estimate over truth", std::move(g)) + "</div>";
}

std::string timing(const std::vector<Json>& events) {
  struct Row {
    int64_t epochs = 0, images = 0, parameters = 0;
    double seconds = 0.0;
    std::string host;
  };
  std::map<int64_t, Row> stages;
  for (const Json& event : events) {
    if (is(event, "stage"))
      stages[event.value("stage", 0)].parameters = event.value("trained_parameters", int64_t{0});
    if (!is(event, "epoch")) continue;
    Row& row = stages[event.value("stage", 0)];
    const Json wall = event.value("wall", Json::object());
    ++row.epochs;
    row.images += event.value("images", int64_t{0});
    row.seconds += wall.value("seconds", 0.0);
    row.host = wall.value("host", "");
  }
  std::string html =
      "<table><tr><th>stage</th><th>epochs</th><th>images</th><th>parameters</th><th>time</th><th>images/s</"
      "th>"
      "<th>host</th></tr>";
  for (const auto& [stage, row] : stages) {
    html += fmt::format(
        "<tr><td>{}</td><td>{}</td><td>{}</td><td>{:.3g} M</td><td>{}</td><td>{:.3g}</td><td>{}</td></tr>",
        stage, row.epochs, row.images, 1e-6 * static_cast<double>(row.parameters),
        format_duration(row.seconds), row.seconds > 0.0 ? static_cast<double>(row.images) / row.seconds : 0.0,
        escape_html(row.host));
  }
  return html + "</table>";
}

}  // namespace opaline::report
