// What `opaline bench` measures: a file each.
#pragma once

#include <CLI/CLI.hpp>

namespace opaline::cli {

void add_bench_conv(CLI::App& bench);
void add_bench_layers(CLI::App& bench);
void add_bench_memory(CLI::App& bench);
void add_bench_net(CLI::App& bench);
void add_bench_noise(CLI::App& bench);
void add_bench_render(CLI::App& bench);
void add_bench_runs(CLI::App& bench);
void add_bench_skip(CLI::App& bench);
void add_bench_step(CLI::App& bench);
void add_bench_stress(CLI::App& bench);

}  // namespace opaline::cli
