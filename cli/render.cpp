// `opaline render`: makes a data set.
#include <fmt/format.h>

#include <filesystem>
#include <memory>
#include <string>
#include <vector>

#include "cli/commands.h"
#include "core/parallel.h"
#include "data/generate.h"
#include "train/config.h"
#include "train/interrupt.h"
#include "train/progress.h"

namespace opaline::cli {
namespace {

struct RenderArguments {
  std::filesystem::path config;
  std::filesystem::path out;
  std::vector<std::string> set;
  int threads = 0;
};

int render(const RenderArguments& arguments) {
  const GenerateConfig config = load_run_config(arguments.config, arguments.set).render;
  set_num_threads(arguments.threads);
  const InterruptGuard signals;
  Progress progress(default_progress());
  int64_t before = -1;
  const GenerateResult result = generate(config, arguments.out,
                                         {.progress =
                                              [&](int64_t done, int64_t total) {
                                                if (before < 0) {
                                                  progress.start(done, total);
                                                } else {
                                                  progress.advance(done - before, "scenes");
                                                }
                                                before = done;
                                              },
                                          .stop = [&] { return signals.signal() != 0; }});
  progress.finish();
  fmt::print("{}: {} scenes rendered, {} kept, {} draws repeated, {} values clamped, {} of {} paths lost\n",
             arguments.out.string(), result.rendered, result.kept, result.redrawn, result.clamped,
             result.faults.lost, result.faults.paths);
  if (!result.skipped.empty()) fmt::print("{} files could not be used:\n", result.skipped.size());
  for (const auto& [file, reason] : result.skipped) fmt::print("  {}\n", reason);
  if (result.complete) return 0;
  fmt::print("interrupted; the same command goes on\n");
  return 128 + signals.signal();
}

}  // namespace

void add_render(CLI::App& app, Outcome& outcome) {
  const auto arguments = std::make_shared<RenderArguments>();
  CLI::App* command = app.add_subcommand(
      "render", "Render a data set; the same command goes on where an earlier one was stopped");
  command->add_option("config", arguments->config, "TOML file with a [render] table")->required();
  command->add_option("--out", arguments->out, "Folder of the data set")->required();
  command->add_option("--set", arguments->set, "table.key=value, wins over the file");
  command->add_option("--threads", arguments->threads, "0: all cores")->check(CLI::NonNegativeNumber);
  command->callback([arguments, &outcome] { outcome.exit_code = render(*arguments); });
}

}  // namespace opaline::cli
