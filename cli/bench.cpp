// `opaline bench`: speed, memory and error.
#include "cli/bench.h"

#include "cli/commands.h"

namespace opaline::cli {

void add_bench(CLI::App& app, Outcome&) {
  CLI::App* bench = app.add_subcommand("bench", "Measure speed, memory and error");
  bench->require_subcommand(1);
  add_bench_conv(*bench);
  add_bench_layers(*bench);
  add_bench_memory(*bench);
  add_bench_net(*bench);
  add_bench_runs(*bench);
  add_bench_skip(*bench);
  add_bench_step(*bench);
  add_bench_stress(*bench);
  add_bench_render(*bench);
  add_bench_noise(*bench);
}

}  // namespace opaline::cli
