// The program `opaline`. Exit codes: 0 success, 1 a failed run, 2 bad usage or config, 130 / 143 interrupted
// after saving.
#include <CLI/CLI.hpp>
#include <cstdio>
#include <exception>
#include <new>

#include "cli/commands.h"
#include "core/error.h"
#include "core/instruction_set.h"

namespace {

int run(int argc, char** argv) {
  CLI::App app{"opaline: shape, illumination and subsurface scattering from one polarisation image"};
  app.set_version_flag("--version", "opaline 0.1.0");
  app.require_subcommand(1);
  opaline::cli::Outcome outcome;
  for (const auto add : opaline::cli::kCommands) {
    if (add != nullptr) add(app, outcome);
  }
  try {
    app.parse(argc, argv);
  } catch (const CLI::ParseError& error) {
    return app.exit(error) == 0 ? 0 : 2;
  }
  return outcome.exit_code;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    opaline::limit_instruction_set();
    return run(argc, argv);
  } catch (const opaline::UsageError& error) {
    std::fprintf(stderr, "opaline: %s\n", error.what());
    return 2;
  } catch (const std::bad_alloc&) {
    std::fprintf(stderr, "opaline: out of memory\n");
    return 1;
  } catch (const std::exception& error) {
    std::fprintf(stderr, "opaline: %s\n", error.what());
    return 1;
  }
}
