#include "train/report.h"

#include <optional>

#include "core/error.h"
#include "core/file.h"
#include "data/chart.h"
#include "data/page.h"
#include "train/log.h"
#include "train/report_parts.h"

namespace opaline {
namespace report {

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
  const NumericsGuard numerics(config.train.numerics);
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

std::string describe(const RunConfig& config) {
  std::vector<std::string_view> inputs;
  for (const InputKind kind : config.model.encode.inputs) inputs.push_back(to_string(kind));
  return fmt::format("{} variant, width {}, build size {}, inputs {}{}{}; batch {} in micro-batches of {}",
                     config.model.variant == Variant::kPaper ? "paper" : "release", config.model.width,
                     config.model.image_size, fmt::join(inputs, " + "),
                     config.model.reconstruction ? ", with reconstruction" : "",
                     config.model.skip == Skip::kSupport ? ", on the object's tiles" : "", config.train.batch,
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
  std::string html = fmt::format("<h1>{}</h1><p class='sub'>{}", name, escape_html(describe(config)));
  if (measured) {
    html += fmt::format("<br>{}, {} training and {} test scenes, {} of them measured",
                        escape_html(measured->model.checkpoint.filename().string()),
                        measured->dataset->size(Split::kTrain), measured->dataset->size(Split::kTest),
                        measured->summary.n);
  }
  html += fmt::format("<br>written {}</p>\n", utc_now());
  if (measured) {
    html += html_section("Errors on test scenes", report::results(measured->summary));
    html +=
        html_section("From the best scene to the worst",
                     report::gallery(measured->model, *measured->dataset, measured->results, options.scenes));
    html += html_section("Scattering parameters", report::scatter(measured->results));
  }
  html += html_section("Training",
                       report::curves(events, measured ? std::optional(measured->summary) : std::nullopt));
  html += html_section("Time", report::timing(events));
  html += html_section("Config", fmt::format("<pre>{}</pre>", escape_html(config.text)));
  write_file_atomically(run.report(), std::string_view(html_page("opaline: " + name, html)));
  return run.report();
}

}  // namespace opaline
