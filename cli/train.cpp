// `opaline train` and `opaline resume`.
#include <csignal>
#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "cli/train.h"
#include "core/error.h"

namespace opaline::cli {
namespace {

namespace fs = std::filesystem;

constexpr int kSignalBase = 128;  // a shell's exit code of a process that a signal ended

/// runs/<config>-1, or the first higher number that is free.
fs::path free_run_folder(const fs::path& config) {
  for (int64_t n = 1;; ++n) {
    const fs::path folder = fs::path("runs") / fmt::format("{}-{}", config.stem().string(), n);
    if (!fs::exists(folder)) return folder;
  }
}

struct TrainArguments {
  fs::path config;
  fs::path run;
  std::vector<std::string> overrides;
};

void run_train(const TrainArguments& arguments, Outcome& outcome) {
  const RunConfig config = load_run_config(arguments.config, arguments.overrides);
  const RunFolder run{arguments.run.empty() ? free_run_folder(arguments.config) : arguments.run};
  fmt::print("run folder: {}\n", run.root.string());
  std::fflush(stdout);
  print_warnings(config);
  report_training(start_training(config, {.run = run}), run, outcome);
}

struct ResumeArguments {
  fs::path run;
  std::vector<std::string> overrides;
  fs::path from;
  bool force = false;
};

void run_resume(const ResumeArguments& arguments, Outcome& outcome) {
  const RunFolder run{arguments.run};
  if (!fs::exists(run.config())) {
    fail_usage(run.root.string(), "is not a run folder: it has no config.toml");
  }
  const RunConfig config = load_run_config(run.config(), arguments.overrides);
  TrainerOptions options{.run = run, .force = arguments.force};
  if (!arguments.from.empty()) options.from = arguments.from;
  print_warnings(config);
  report_training(resume_training(config, options), run, outcome);
}

}  // namespace

void print_warnings(const RunConfig& config) {
  for (const std::string& warning : config.warnings) fmt::print(stderr, "warning: {}\n", warning);
}

void report_training(const TrainResult& result, const RunFolder& run, Outcome& outcome) {
  if (result.signal == 0) {
    fmt::print("trained: {} steps, weights in {}\n", result.step, run.checkpoints().string());
    return;
  }
  fmt::print("{} after step {}: saved; opaline resume {} goes on\n",
             result.signal == SIGINT ? "interrupted" : "terminated", result.step, run.root.string());
  outcome.exit_code = kSignalBase + result.signal;
}

void add_train(CLI::App& app, Outcome& outcome) {
  const auto arguments = std::make_shared<TrainArguments>();
  CLI::App* command = app.add_subcommand("train",
                                         "Train both stages of the cascade from a config. SIGINT and SIGTERM "
                                         "end the step in progress, save, and\n"
                                         "exit with 130 and 143; a second one ends at once.");
  command->add_option("config", arguments->config, "TOML file")->required();
  command->add_option("--run", arguments->run,
                      "Run folder: config, log, checkpoints. Without it: runs/CONFIG-1, -2, ..");
  command
      ->add_option("--set", arguments->overrides,
                   "Overrides a key of the config, such as --set train.seed=2; repeatable")
      ->type_name("KEY=VALUE")
      ->allow_extra_args(false);
  command->callback([arguments, &outcome] { run_train(*arguments, outcome); });
}

void add_resume(CLI::App& app, Outcome& outcome) {
  const auto arguments = std::make_shared<ResumeArguments>();
  CLI::App* command = app.add_subcommand(
      "resume",
      "Go on with a run from its newest sound checkpoint, to the same bits as if it had never stopped");
  command->add_option("run", arguments->run, "Run folder")->required();
  command->add_option("--from", arguments->from,
                      "Checkpoint to go on from, such as RUN/checkpoints/step-100 or one of RUN/failures");
  command
      ->add_option("--set", arguments->overrides,
                   "Overrides a key of the run's config; one that decides the numbers needs --force")
      ->type_name("KEY=VALUE")
      ->allow_extra_args(false);
  command->add_flag("--force", arguments->force, "Go on although the config or the data set has changed");
  command->callback([arguments, &outcome] { run_resume(*arguments, outcome); });
}

}  // namespace opaline::cli
