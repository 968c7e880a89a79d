// `opaline render`: makes a data set.
#include <fmt/format.h>

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "cli/commands.h"
#include "core/parallel.h"
#include "core/progress.h"
#include "data/contact_sheet.h"
#include "data/generate.h"
#include "train/config.h"
#include "train/interrupt.h"

namespace opaline::cli {
namespace {

struct RenderArguments {
  std::filesystem::path config;
  std::filesystem::path out;
  std::vector<std::string> set;
  int threads = 0;
  int64_t contact_sheet = ContactSheetOptions().scenes;
};

/// Shows both steps of generate() on one bar, each from its start.
class GenerateProgress {
 public:
  void operator()(GenerateStep step, int64_t done, int64_t total) {
    if (step != step_ || before_ < 0) {
      progress_.finish();
      const bool rendering = step == GenerateStep::kRender;
      progress_.start(done, total, {.items = rendering ? "scenes" : "files", .all_units = true});
    } else {
      progress_.advance(done - before_, step == GenerateStep::kRender ? "rendered" : "verified");
    }
    step_ = step;
    before_ = done < total ? done : -1;
  }

 private:
  Progress progress_{default_progress()};
  GenerateStep step_ = GenerateStep::kRender;
  int64_t before_ = -1;
};

int render(const RenderArguments& arguments) {
  const GenerateConfig config = load_run_config(arguments.config, arguments.set).render;
  set_num_threads(arguments.threads);
  const InterruptGuard signals;
  GenerateResult result;
  {
    GenerateProgress progress;
    result = generate(
        config, arguments.out,
        {.progress = [&](GenerateStep step, int64_t done, int64_t total) { progress(step, done, total); },
         .stop = [&] { return signals.signal() != 0; }});
  }
  fmt::print("{}: {} scenes rendered, {} kept, {} draws repeated, {} values clamped, {} of {} paths lost\n",
             arguments.out.string(), result.rendered, result.kept, result.redrawn, result.clamped,
             result.faults.lost, result.faults.paths);
  if (result.damaged > 0) fmt::print("{} damaged files were rendered again\n", result.damaged);
  if (!result.skipped.empty()) fmt::print("{} files could not be used:\n", result.skipped.size());
  for (const auto& [file, reason] : result.skipped) fmt::print("  {}\n", reason);
  if (!result.complete) {
    fmt::print("interrupted; the same command goes on\n");
    return 128 + signals.signal();
  }
  fmt::print("{} files verified\n", result.verified);
  if (arguments.contact_sheet > 0) {
    const std::filesystem::path sheet = arguments.out / "contact_sheet.png";
    write_picture(sheet, contact_sheet(*open_dataset(arguments.out), {.scenes = arguments.contact_sheet}));
    fmt::print("{}\n", sheet.string());
  }
  return 0;
}

}  // namespace

void add_render(CLI::App& app, Outcome& outcome) {
  const auto arguments = std::make_shared<RenderArguments>();
  CLI::App* command = app.add_subcommand(
      "render", "Render a data set; the same command goes on where an earlier one was stopped");
  command->add_option("config", arguments->config, "TOML file with a [render] table")->required();
  command->add_option("--out", arguments->out, "Folder of the data set")->required();
  command->add_option("--set", arguments->set, "table.key=value, wins over the file");
  command->add_option("--contact-sheet", arguments->contact_sheet, "Scenes in DIR/contact_sheet.png; 0: none")
      ->check(CLI::Range(0, 400))
      ->capture_default_str();
  command->add_option("--threads", arguments->threads, "0: all cores")->check(CLI::NonNegativeNumber);
  command->callback([arguments, &outcome] { outcome.exit_code = render(*arguments); });
}

}  // namespace opaline::cli
