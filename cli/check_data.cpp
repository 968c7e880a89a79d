// `opaline check-data`: reads every scene of a data set and says what it found.
#include <filesystem>
#include <iostream>
#include <memory>

#include "cli/commands.h"
#include "data/check.h"

namespace opaline::cli {

void add_check_data(CLI::App& app, Outcome& outcome) {
  struct Arguments {
    std::filesystem::path folder;
    size_t max_problems = 20;
  };
  const auto arguments = std::make_shared<Arguments>();
  CLI::App* command = app.add_subcommand(
      "check-data", "Read every scene of a data set and report damage, ranges and the frame of its normals");
  command->add_option("folder", arguments->folder, "data set (any layout)")->required();
  command->add_option("--max-problems", arguments->max_problems, "problems and warnings to list")
      ->capture_default_str();
  command->callback([arguments, &outcome] {
    const DatasetCheck check = check_dataset(*open_dataset(arguments->folder));
    std::cout << to_text(check, arguments->max_problems);
    if (!check.sound()) outcome.exit_code = 1;
  });
}

}  // namespace opaline::cli
