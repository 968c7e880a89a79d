// `opaline report`: a run as one HTML page.
#include "train/report.h"

#include <memory>

#include "cli/commands.h"

namespace opaline::cli {

void add_report(CLI::App& app, Outcome&) {
  struct Arguments {
    std::filesystem::path run;
    ReportOptions options;
  };
  const auto arguments = std::make_shared<Arguments>();
  CLI::App* command = app.add_subcommand(
      "report", "Write RUN/report.html: errors beside the training mean, pictures of test scenes, curves");
  command->add_option("run", arguments->run, "Run folder")->required();
  command->add_option("--data", arguments->options.data, "Data set; without it the one trained on");
  command->add_option("--scenes", arguments->options.scenes, "Test scenes shown, from the best to the worst")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  command->add_option("--max-scenes", arguments->options.max_scenes, "Test scenes measured; 0: all")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  command->callback([arguments] {
    const std::filesystem::path page =
        write_report({arguments->run}, arguments->options,
                     [](std::string_view line) { fmt::print(stderr, "warning: {}\n", line); });
    fmt::print("{}\n", page.string());
  });
}

}  // namespace opaline::cli
