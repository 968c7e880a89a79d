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
  int64_t max_scenes = 0;
};

/// The training scenes whose mean is the yardstick: those beside the test scenes, or else those that the run
/// was trained on.
MeanPredictor training_mean(const Dataset& dataset, const RunConfig& config) {
  if (dataset.size(Split::kTrain) > 0) return fit_mean_predictor(dataset);
  return fit_mean_predictor(*open_dataset(config.data.path));
}

void run_eval(const EvalArguments& arguments) {
  const TrainedModel model = load_trained_model(
      {arguments.run}, [](std::string_view line) { fmt::print(stderr, "warning: {}\n", line); });
  const std::shared_ptr<const Dataset> dataset = open_dataset(arguments.data);
  if (dataset->size(Split::kTest) == 0) fail(arguments.data.string(), "has no test scenes");
  const MeanPredictor mean = training_mean(*dataset, model.config);
  const EvaluationSummary summary = summarize(
      evaluate(*model.cascade, dataset, model.config.model.encode, &mean,
               {.max_scenes = arguments.max_scenes, .threads = static_cast<int>(model.config.data.threads)}));
  // With the JSON on standard output, the table must not be in it.
  const bool json_only = arguments.json == "-";
  if (!json_only)
    fmt::print("{} of {}\n{}", model.checkpoint.filename().string(), arguments.run.string(),
               format_table(summary));
  if (arguments.json.empty()) return;
  const std::string text = to_json(summary).dump(2) + "\n";
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
  command->add_option("--max-scenes", arguments->max_scenes, "Measure the first so many; 0: all")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  command->callback([arguments] { run_eval(*arguments); });
}

}  // namespace opaline::cli
