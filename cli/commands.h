// The commands of the program: one file and one line each. A command's function adds its subcommand to the
// parser and sets a callback that runs it; errors are thrown (main.cpp maps them to exit codes).
#pragma once

#include <CLI/CLI.hpp>

namespace opaline::cli {

/// What the callbacks leave behind for main: the exit code, where it is not 0 without being an error.
struct Outcome {
  int exit_code = 0;
};

using AddCommand = void (*)(CLI::App& app, Outcome& outcome);

// Declarations (one a command).
void add_bench(CLI::App& app, Outcome& outcome);
void add_check_data(CLI::App& app, Outcome& outcome);
void add_eval(CLI::App& app, Outcome& outcome);
void add_forward(CLI::App& app, Outcome& outcome);
void add_gradcheck(CLI::App& app, Outcome& outcome);
void add_inspect(CLI::App& app, Outcome& outcome);
void add_predict(CLI::App& app, Outcome& outcome);
void add_render(CLI::App& app, Outcome& outcome);
void add_report(CLI::App& app, Outcome& outcome);
void add_resume(CLI::App& app, Outcome& outcome);
void add_train(CLI::App& app, Outcome& outcome);
void add_validate(CLI::App& app, Outcome& outcome);

// The table that main.cpp walks, in the order of --help.
inline constexpr AddCommand kCommands[] = {
    add_render,  add_train,     add_resume,   add_eval,    add_predict, add_report, add_check_data,
    add_inspect, add_gradcheck, add_validate, add_forward, add_bench,   nullptr,
};

}  // namespace opaline::cli
