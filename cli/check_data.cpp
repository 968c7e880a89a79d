// `opaline check-data`: reads every scene of a data set and says what it found.
#include <fmt/format.h>

#include <filesystem>
#include <iostream>
#include <memory>

#include "cli/commands.h"
#include "core/file.h"
#include "core/progress.h"
#include "data/check.h"
#include "data/check_page.h"
#include "data/contact_sheet.h"

namespace opaline::cli {
namespace {

struct CheckArguments {
  std::filesystem::path folder;
  std::filesystem::path html;
  std::filesystem::path json;
  std::filesystem::path contact_sheet;
  size_t max_problems = 20;
};

int check_data(const CheckArguments& arguments) {
  const std::unique_ptr<Dataset> dataset = open_dataset(arguments.folder);
  Progress progress(default_progress());
  const DatasetCheck check = check_dataset(*dataset, {.progress = [&](int64_t done, int64_t total) {
    if (done == 0) {
      progress.start(0, total, {.items = "scenes", .all_units = true});
    } else {
      progress.advance(1, "checked");
    }
  }});
  progress.finish();
  std::cout << to_text(check, arguments.max_problems);
  if (!arguments.html.empty()) write_file_atomically(arguments.html, check_page(check, *dataset));
  if (!arguments.json.empty()) write_file_atomically(arguments.json, to_json(check));
  if (!arguments.contact_sheet.empty()) write_picture(arguments.contact_sheet, contact_sheet(*dataset));
  return check.sound() ? 0 : 1;
}

}  // namespace

void add_check_data(CLI::App& app, Outcome& outcome) {
  const auto arguments = std::make_shared<CheckArguments>();
  CLI::App* command = app.add_subcommand("check-data",
                                         "Read every scene of a data set and report damage, conventions and "
                                         "ranges; exit code 1 where something is wrong");
  command->add_option("folder", arguments->folder, "data set (any layout)")->required();
  command->add_option("--html", arguments->html, "write the findings as one page with images and histograms");
  command->add_option("--json", arguments->json, "write them as JSON");
  command->add_option("--contact-sheet", arguments->contact_sheet, "write a PNG of scenes side by side");
  command->add_option("--max-problems", arguments->max_problems, "problems and warnings of scenes to list")
      ->capture_default_str();
  command->callback([arguments, &outcome] { outcome.exit_code = check_data(*arguments); });
}

}  // namespace opaline::cli
