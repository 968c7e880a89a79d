// `opaline eval`: the paper's table over the test scenes of a data set.
#include <filesystem>
#include <iostream>
#include <memory>

#include "cli/commands.h"
#include "core/error.h"
#include "core/file.h"
#include "train/evaluate.h"
#include "train/trained_model.h"

namespace opaline::cli {
namespace {

namespace fs = std::filesystem;

struct EvalArguments {
  fs::path run, data, json;
  std::vector<std::string> only;
  int64_t max_scenes = 0;
  bool sensor = false;
};

/// The training scenes whose mean is the yardstick: those beside the test scenes, or else those that the run
/// was trained on.
MeanPredictor training_mean(const Dataset& dataset, const RunConfig& config) {
  constexpr int64_t kEnough = 4000;
  if (dataset.size(Split::kTrain) > 0) return fit_mean_predictor(dataset, kEnough, config.data.damaged);
  return fit_mean_predictor(*open_dataset(config.data.path), kEnough, config.data.damaged);
}

void run_eval(const EvalArguments& arguments) {
  const auto warn = [](std::string_view line) { fmt::print(stderr, "warning: {}\n", line); };
  const TrainedModel model = load_trained_model({arguments.run}, warn);
  const RunConfig& config = model.config;
  const NumericsGuard numerics(config.train.numerics);
  const std::shared_ptr<const Dataset> dataset = open_dataset(arguments.data);
  if (dataset->size(Split::kTest) == 0) fail(arguments.data.string(), "has no test scenes");
  const MeanPredictor mean = training_mean(*dataset, config);
  EvaluateOptions options{.columns = parse_columns(arguments.only),
                          .max_scenes = arguments.max_scenes,
                          .threads = static_cast<int>(config.data.threads),
                          .damaged = config.data.damaged,
                          .warn = warn};
  const auto measured = [&] {
    return summarize(evaluate(*model.cascade, dataset, config.model.encode, &mean, options));
  };
  const EvaluationSummary clean = measured();
  nlohmann::ordered_json json = to_json(clean);
  std::string table = fmt::format("{} of {}\n{}", model.checkpoint.filename().string(),
                                  arguments.run.string(), format_table(clean));
  if (arguments.sensor) {
    options.capture.sensor = config.data.capture.sensor;
    options.capture.sensor.on = true;
    options.warn = {};  // the same scenes again
    const EvaluationSummary sensor = measured();
    json["sensor"] = to_json(sensor);
    table += "\nwith the errors of a sensor\n" + format_table(sensor);
  }
  // With the JSON on standard output, the table must not be in it.
  const bool json_only = arguments.json == "-";
  if (!json_only) fmt::print("{}", table);
  if (arguments.json.empty()) return;
  const std::string text = json.dump(2) + "\n";
  if (json_only) {
    fmt::print("{}", text);
  } else {
    write_file_atomically(arguments.json, std::string_view(text));
  }
}

}  // namespace

void add_eval(CLI::App& app, Outcome&) {
  const auto arguments = std::make_shared<EvalArguments>();
  CLI::App* command = app.add_subcommand(
      "eval",
      "Measure a run's newest checkpoint on the test scenes of a data set, beside predicting the training "
      "mean.\n"
      "Columns: normal, depth, sigma_t, albedo and g as the released implementation measures them, then the\n"
      "mean angle between normals in degrees and the depth error after one scale and shift.");
  command->add_option("run", arguments->run, "Run folder")->required();
  command->add_option("--data", arguments->data, "Data set")->required();
  command->add_option("--json", arguments->json,
                      "Also write the numbers to this file; - for standard output");
  command
      ->add_option("--only", arguments->only,
                   fmt::format("Columns of these alone, and no network that they do not need: {}",
                               fmt::join(kColumnNames, ", ")))
      ->delimiter(',')
      ->check(CLI::IsMember(std::vector<std::string>(kColumnNames.begin(), kColumnNames.end())));
  command->add_option("--max-scenes", arguments->max_scenes, "Measure the first so many; 0: all")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  command->add_flag(
      "--sensor", arguments->sensor,
      "Also measure on images with the errors of a real sensor (strengths: [data] sensor_.. of the run's "
      "config); the JSON gets them under \"sensor\"");
  command->callback([arguments] { run_eval(*arguments); });
}

}  // namespace opaline::cli
