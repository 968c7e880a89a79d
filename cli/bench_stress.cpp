// `opaline bench stress`: what float32 makes of hard inputs, operation by operation.
#include <fmt/format.h>

#include <memory>
#include <nlohmann/json.hpp>

#include "cli/bench.h"
#include "cli/numerics_option.h"
#include "core/check/stress.h"
#include "core/parallel.h"

namespace opaline::cli {
namespace {

struct Arguments {
  Numerics numerics = Numerics::kBalanced;
  std::filesystem::path folder;
  bool json = false;
};

void print_table(const std::vector<check::StressSummary>& summaries) {
  fmt::print("| {:<19} | {:<32} | {:>7} | {:<32} | {:>8} | {:>4} |\n", "operation", "worst forward", "error",
             "worst backward", "error", "lost");
  fmt::print("|{:-<21}|{:-<34}|{:->8}:|{:-<34}|{:->9}:|{:->5}:|\n", "", "", "", "", "", "");
  for (const check::StressSummary& s : summaries) {
    fmt::print("| {:<19} | {:<32} | {:>7.1e} | {:<32} | {:>8.1e} | {:>4} |\n", s.operation, s.forward_case,
               s.worst.forward.value, s.backward_case, s.worst.backward.value, s.lost);
  }
}

void print_json(const std::vector<check::StressSummary>& summaries, Numerics numerics) {
  nlohmann::ordered_json json = {{"numerics", to_string(numerics)}};
  for (const check::StressSummary& s : summaries) {
    json["operations"][s.operation] = {{"cases", s.cases},
                                       {"lost", s.lost},
                                       {"forward", s.worst.forward.value},
                                       {"forward_case", s.forward_case},
                                       {"backward", s.worst.backward.value},
                                       {"backward_case", s.backward_case}};
  }
  fmt::print("{}\n", json.dump());
}

void run_bench_stress(const Arguments& arguments) {
  const Numerics numerics = arguments.numerics;
  const ThreadsGuard one_thread(1);
  const auto summaries = arguments.folder.empty() ? check::run_stress(numerics)
                                                  : check::export_stress(numerics, arguments.folder);
  arguments.json ? print_json(summaries, numerics) : print_table(summaries);
}

}  // namespace

void add_bench_stress(CLI::App& bench) {
  const auto arguments = std::make_shared<Arguments>();
  CLI::App* command = bench.add_subcommand("stress",
                                           "Largest errors of every operation in float32 against float64, "
                                           "over inputs that are hard: magnitudes of\n"
                                           "1e-30 to 1e30, denormals, constants, zeros, offsets, saturation, "
                                           "NaN and infinities. Errors are relative\n"
                                           "(docs/numerics.md says to what); 'inf' is a number where none "
                                           "should be, or none where one should be.");
  add_numerics_option(*command, arguments->numerics);
  command->add_flag("--json", arguments->json, "Print one JSON object");
  command->add_option("--export", arguments->folder,
                      "Also write inputs and float64 results here, for scripts/parity/stress.py");
  command->callback([arguments] { run_bench_stress(*arguments); });
}

}  // namespace opaline::cli
