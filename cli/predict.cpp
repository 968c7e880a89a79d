// `opaline predict`: maps and parameters of captures and scenes.
#include <filesystem>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "cli/commands.h"
#include "core/error.h"
#include "train/predict.h"

namespace opaline::cli {
namespace {

namespace fs = std::filesystem;

struct PredictArguments {
  fs::path run, out;
  std::vector<fs::path> inputs;
  std::vector<std::string> only;
  int64_t size = -1;
};

void run_predict(const PredictArguments& arguments) {
  PredictOptions options{.wanted = parse_wanted(arguments.only)};
  // Everything is opened before anything is written.
  std::vector<PredictInput> inputs;
  std::set<std::string> names;
  for (const fs::path& path : arguments.inputs) {
    for (PredictInput& input : open_predict_input(path)) {
      if (!names.insert(input.name).second) {
        fail_usage("predict", "two inputs are named '{}' ({} is the second): predict them into two folders",
                   input.name, path.string());
      }
      inputs.push_back(std::move(input));
    }
  }
  const TrainedModel model = load_trained_model(
      {arguments.run}, [](std::string_view line) { fmt::print(stderr, "warning: {}\n", line); },
      networks_for(options.wanted));
  if (options.wanted.sss && !model.cascade->has("sss")) {
    if (!arguments.only.empty()) {
      fail_usage("predict", "{} is of stage 1, which has no scattering parameters",
                 model.checkpoint.string());
    }
    fmt::print(stderr, "warning: {} is of stage 1: no scattering parameters\n", model.checkpoint.string());
  }
  options.size = arguments.size < 0 ? model.config.model.image_size : arguments.size;
  const NumericsGuard numerics(model.config.train.numerics);
  for (const PredictInput& input : inputs) {
    fmt::print("{}\n", predict(model, input, options, arguments.out).string());
  }
}

}  // namespace

void add_predict(CLI::App& app, Outcome&) {
  const auto arguments = std::make_shared<PredictArguments>();
  CLI::App* command = app.add_subcommand(
      "predict",
      "Estimate shape, light and scattering with a run's newest checkpoint. Writes OUT/NAME/: input.png,\n"
      "normal.png, depth.png, prediction.exr (normal, depth, mask) and prediction.json (parameters, light).");
  command->add_option("run", arguments->run, "Run folder")->required();
  command
      ->add_option(
          "input", arguments->inputs,
          "Capture folders (p0.png p45.png p90.png p135.png mask.png), folders of captures, data sets "
          "(their test scenes) or scenes/NNNNNN.exr of a data set")
      ->required();
  command->add_option("--out", arguments->out, "Output folder")->required();
  command->add_option("--only", arguments->only, "Some of normal, depth, illumination, sss")->delimiter(',');
  command
      ->add_option("--size", arguments->size,
                   "Scale the longer side down to this; 0: as it is. Without it: the size trained at")
      ->check(CLI::NonNegativeNumber);
  command->callback([arguments] { run_predict(*arguments); });
}

}  // namespace opaline::cli
