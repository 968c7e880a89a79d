#include "train/report.h"

#include <optional>

#include "core/error.h"
#include "core/file.h"
#include "train/chart.h"
#include "train/log.h"
#include "train/report_parts.h"

namespace opaline {
namespace report {

std::string style() {
  return R"(<style>
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, "DejaVu Sans", sans-serif; color: #1c2733; background: #f4f6f8; margin: 0; }
main { max-width: 1320px; margin: 0 auto; padding: 24px; }
h1 { font-size: 26px; margin: 0 0 4px; }
h2 { font-size: 19px; margin: 0 0 12px; }
section { background: #fff; border: 1px solid #dde3e9; border-radius: 8px; padding: 18px 22px; margin-top: 18px; }
p.sub { margin: 0 0 8px; color: #5a6876; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(150px, 1fr)); gap: 10px; margin-bottom: 16px; }
.card { border: 1px solid #dde3e9; border-radius: 8px; padding: 8px 9px; }
.card b { display: block; font-size: 24px; }
.card span { color: #5a6876; font-size: 12px; white-space: nowrap; }
.card span.good { color: #1b7f4b; } .card span.bad { color: #b3372f; }
.good { color: #1b7f4b; } .bad { color: #b3372f; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: 5px 11px; border-bottom: 1px solid #e6ebf0; white-space: nowrap; }
th:first-child, td:first-child { text-align: left; }
th { color: #5a6876; font-weight: 600; }
table.small { font-size: 11px; margin-top: 4px; } table.small th, table.small td { padding: 1px 5px; }
.charts { display: flex; flex-wrap: wrap; gap: 14px; }
.chart .title { font-size: 13px; font-weight: 600; fill: #1c2733; }
.chart .tick { font-size: 11px; fill: #5a6876; } .chart .note { font-size: 11px; fill: #b3372f; }
.chart .grid { stroke: #e6ebf0; } .chart .axis { stroke: #8b98a5; }
.chart .mark { stroke: #8b98a5; stroke-dasharray: 4 4; } .chart .reference { stroke: #b3372f; stroke-dasharray: 5 4; }
.scene { display: flex; flex-wrap: wrap; gap: 8px; align-items: flex-start; padding: 10px 0; border-top: 1px solid #e6ebf0; }
.facts { flex: none; width: 262px; font-size: 13px; }
figure { margin: 0; } figure img { width: 126px; height: auto; display: block; border: 1px solid #dde3e9; image-rendering: pixelated; }
figcaption { font-size: 11px; color: #5a6876; text-align: center; }
.legend { font-size: 12px; color: #5a6876; margin-right: 24px; }
.legend i { display: inline-block; width: 120px; height: 10px; margin: 0 4px; border-radius: 2px; }
pre { font: 12px/1.45 "DejaVu Sans Mono", monospace; overflow-x: auto; margin: 8px 0 0; }
</style>
)";
}

std::string results(const EvaluationSummary& summary) {
  const auto digits = [](size_t m) { return m == static_cast<size_t>(Metric::kAngularDegrees) ? 2 : 4; };
  constexpr std::array<std::string_view, kMetricCount> kTitles = {
      "normal", "depth", "sigma_t", "albedo", "g", "normal angle, degrees", "depth, aligned"};
  std::string cards = "<div class='cards'>";
  std::string head = "<tr><th></th>";
  std::string cascade = "<tr><td>cascade</td>";
  std::string interval = "<tr><td>95 % interval</td>";
  std::string mean = "<tr><td>training mean</td>";
  std::string change = "<tr><td>against the mean</td>";
  for (const size_t m : {5U, 6U, 0U, 1U, 2U, 3U, 4U}) {
    head += fmt::format("<th>{}</th>", kTitles[m]);
    const auto& value = summary.cascade[m];
    const auto& base = summary.mean_predictor[m];
    cascade += value ? fmt::format("<td><b>{:.{}f}</b></td>", *value, digits(m)) : "<td>-</td>";
    const auto& ci = summary.ci95[m];
    interval += ci ? fmt::format("<td>{:.{}f} .. {:.{}f}</td>", ci->low, digits(m), ci->high, digits(m))
                   : "<td>-</td>";
    mean += base ? fmt::format("<td>{:.{}f}</td>", *base, digits(m)) : "<td>-</td>";
    if (!value || !base || !(*base > 0.0)) {
      change += "<td>-</td>";
      continue;
    }
    const double percent = 100.0 * (*value / *base - 1.0);
    const std::string_view tone = percent < 0.0 ? "good" : "bad";
    change += fmt::format("<td class='{}'>{:+.1f} %</td>", tone, percent);
    cards += fmt::format(
        "<div class='card'><span>{}</span><b>{:.{}f}</b><span class='{}'>{:+.1f} % against "
        "mean</span></div>",
        kTitles[m], *value, digits(m), tone, percent);
  }
  return cards + "</div><table>" + head + "</tr>" + cascade + "</tr>" + interval + "</tr>" + mean + "</tr>" +
         change + "</tr></table>";
}

}  // namespace report

namespace {

struct Measured {
  TrainedModel model;
  std::shared_ptr<const Dataset> dataset;
  std::vector<SceneResult> results;
  EvaluationSummary summary;
};

/// Everything that needs weights and scenes.
Measured measure_run(const RunFolder& run, const RunConfig& config, const ReportOptions& options,
                     const Warn& warn) {
  Measured measured;
  measured.model = load_trained_model(run, warn);
  measured.dataset =
      open_dataset(options.data.empty() ? std::filesystem::path(config.data.path) : options.data);
  const MeanPredictor mean = fit_mean_predictor(*measured.dataset);
  measured.results =
      evaluate(*measured.model.cascade, measured.dataset, config.model.encode, &mean,
               {.max_scenes = options.max_scenes, .threads = static_cast<int>(config.data.threads)});
  measured.summary = summarize(measured.results);
  return measured;
}

std::string section(std::string_view title, const std::string& body) {
  return body.empty() ? body : fmt::format("<section><h2>{}</h2>{}</section>\n", title, body);
}

std::string describe(const RunConfig& config) {
  std::vector<std::string_view> inputs;
  for (const InputKind kind : config.model.encode.inputs) inputs.push_back(to_string(kind));
  return fmt::format("{} variant, width {}, build size {}, inputs {}{}; batch {} in micro-batches of {}",
                     config.model.variant == Variant::kPaper ? "paper" : "release", config.model.width,
                     config.model.image_size, fmt::join(inputs, " + "),
                     config.model.reconstruction ? ", with reconstruction" : "", config.train.batch,
                     config.train.micro_batch);
}

}  // namespace

std::filesystem::path write_report(const RunFolder& run, const ReportOptions& options, const Warn& warn) {
  if (!std::filesystem::exists(run.config())) {
    fail_usage(run.root.string(), "is not a run folder: it has no config.toml");
  }
  const RunConfig config = load_run_config(run.config());
  const std::vector<nlohmann::json> events = read_events(run.metrics());
  std::optional<Measured> measured;
  try {
    measured = measure_run(run, config, options, warn);
  } catch (const Error& error) {
    warn(fmt::format("the report has no results: {}", error.what()));
  }
  const std::string name =
      escape_html(std::filesystem::absolute(run.root).lexically_normal().filename().string());
  std::string html = "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>";
  html += "<meta name='viewport' content='width=device-width, initial-scale=1'>";
  html += fmt::format("<title>opaline: {}</title>\n{}</head><body><main>\n", name, report::style());
  html += fmt::format("<h1>{}</h1><p class='sub'>{}", name, escape_html(describe(config)));
  if (measured) {
    html += fmt::format("<br>{}, {} training and {} test scenes, {} of them measured",
                        escape_html(measured->model.checkpoint.filename().string()),
                        measured->dataset->size(Split::kTrain), measured->dataset->size(Split::kTest),
                        measured->summary.n);
  }
  html += fmt::format("<br>written {}</p>\n", utc_now());
  if (measured) {
    html += section("Errors on test scenes", report::results(measured->summary));
    html += section("From the best scene to the worst",
                    report::gallery(measured->model, *measured->dataset, measured->results, options.scenes));
    html += section("Scattering parameters", report::scatter(measured->results));
  }
  html +=
      section("Training", report::curves(events, measured ? std::optional(measured->summary) : std::nullopt));
  html += section("Time", report::timing(events));
  html += section("Config", fmt::format("<pre>{}</pre>", escape_html(config.text)));
  html += "</main></body></html>\n";
  write_file_atomically(run.report(), std::string_view(html));
  return run.report();
}

}  // namespace opaline
