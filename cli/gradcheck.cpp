// `opaline gradcheck`: operations, networks and the loss of a config against difference quotients, and
// operations against their references too, on small shapes.
#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <set>
#include <string>
#include <vector>

#include "cli/commands.h"
#include "core/check/op_case.h"
#include "core/check/run.h"
#include "core/error.h"
#include "core/parallel.h"
#include "data/toml_config.h"
#include "models/check.h"
#include "train/check.h"

namespace opaline::cli {
namespace {

constexpr double kLimit = 1e-6;

struct GradcheckArguments {
  std::string target;
  std::filesystem::path inputs;
  bool verbose = false;
};

std::string format_error(double error) {
  return fmt::format("{:.1e}", error);
}

/// The table: what was checked on which inputs, its errors, the limit of the last one, the verdict.
class Table {
 public:
  Table() { row("case", "inputs", "value", "float32", "gradient", "limit", "verdict"); }

  void row(std::string_view name, std::string_view inputs, std::string_view value, std::string_view narrow,
           std::string_view gradient, std::string_view limit, std::string_view verdict) {
    fmt::print("{:<36} {:<44} {:>8} {:>8} {:>8} {:>8}  {}\n", name, inputs, value, narrow, gradient, limit,
               verdict);
    std::fflush(stdout);
  }

  /// A row that passes or fails.
  void result(std::string_view name, std::string_view inputs, std::string_view value, std::string_view narrow,
              std::string_view gradient, double limit, bool good) {
    row(name, inputs, value, narrow, gradient, format_error(limit), good ? "ok" : "FAILED");
    ++count_;
    if (!good) ++failed_;
  }

  /// The last line; the exit code.
  int finish() const {
    fmt::print("{} checked, {} failed\n", count_, failed_);
    return failed_ == 0 ? 0 : 1;
  }

 private:
  int64_t count_ = 0;
  int64_t failed_ = 0;
};

const check::GradientError& worst_of(const std::vector<check::GradientError>& results) {
  return *std::max_element(results.begin(), results.end(), [](const auto& a, const auto& b) {
    if (std::isnan(a.error) || std::isnan(b.error)) return std::isnan(b.error) && !std::isnan(a.error);
    return a.error < b.error;
  });
}

void print_leaves(const std::vector<check::GradientError>& results) {
  for (const check::GradientError& leaf : results) {
    fmt::print("    {:<60} error {:.1e}, gradient norm {:.3g}, {} redrawn\n", leaf.name, leaf.error,
               leaf.norm, leaf.redrawn);
  }
}

void check_operation(const check::OpCase& op_case, bool verbose, Table& table) {
  std::vector<std::string> inputs;
  for (const check::InputSpec& spec : op_case.inputs) {
    inputs.push_back(fmt::format("{} {}", spec.name, to_string(spec.shape)));
  }
  const auto& limits = op_case.tolerances;
  const double wide = check::reference_error(op_case, check::run_case(op_case, DType::kFloat64));
  const double narrow = check::reference_error(op_case, check::run_case(op_case, DType::kFloat32));
  bool good = wide <= limits.float64 && narrow <= limits.float32;
  std::string gradient = "-";  // at a kink or an infinity there are no difference quotients
  const auto results = check::gradient_errors(op_case);
  if (!results.empty()) {
    const double error = worst_of(results).error;
    gradient = format_error(error);
    good = good && error <= limits.gradient;
  }
  table.result(op_case.name, fmt::format("{}", fmt::join(inputs, ", ")), format_error(wide),
               format_error(narrow), gradient, limits.gradient, good);
  if (verbose) print_leaves(results);
}

/// One row for many tensors: their number and the worst of them.
void report_tensors(const std::string& name, const std::vector<check::GradientError>& results, bool verbose,
                    Table& table) {
  const check::GradientError& worst = worst_of(results);
  table.result(name, fmt::format("{} tensors, worst {}", results.size(), worst.name), "-", "-",
               format_error(worst.error), kLimit, worst.error <= kLimit);
  if (verbose) print_leaves(results);
}

void check_network(std::string_view name, bool verbose, Table& table) {
  for (const bool training : {true, false}) {
    report_tensors(fmt::format("{} {}", name, training ? "train" : "eval"),
                   network_gradient_errors(name, training), verbose, table);
  }
}

void check_config(const std::filesystem::path& path, const RunConfig& config, bool verbose, Table& table) {
  for (const int stage : {1, 2}) {
    if (config.stages[static_cast<size_t>(stage - 1)].epochs == 0) continue;
    report_tensors(fmt::format("{} stage {}", path.filename().string(), stage),
                   config_gradient_errors(config, stage), verbose, table);
  }
}

[[noreturn]] void refuse(const std::string& target) {
  std::set<std::string> names(kNetworkNames.begin(), kNetworkNames.end());
  for (const check::OpCase& op_case : check::op_cases()) names.emplace(op_case.operation());
  const std::vector<std::string> list(names.begin(), names.end());
  const std::string near = did_you_mean(target, list);
  fail_usage("gradcheck", "'{}' is no operation, network or config file{}; there are {}", target,
             near.empty() ? "" : fmt::format(" (did you mean '{}'?)", near), fmt::join(list, ", "));
}

int run_gradcheck(const GradcheckArguments& arguments) {
  const std::string& target = arguments.target;
  if (!arguments.inputs.empty()) {
    check::write_case_inputs(arguments.inputs);
    return 0;
  }
  const bool everything = target.empty();
  const auto is_network = [&](std::string_view name) { return everything || target == name; };
  const auto is_case = [&](const check::OpCase& op_case) {
    return everything || target == op_case.operation() || target == op_case.name;
  };
  const bool network = std::ranges::any_of(kNetworkNames, is_network);
  const bool operation = std::ranges::any_of(check::op_cases(), is_case);
  const bool config = !network && !operation;
  if (config && !target.ends_with(".toml") && !std::filesystem::is_regular_file(target)) refuse(target);

  const ThreadsGuard one_thread(1);
  const RunConfig run = config ? load_run_config(target) : RunConfig{};
  Table table;
  if (config) check_config(target, run, arguments.verbose, table);
  for (const check::OpCase& op_case : check::op_cases()) {
    if (is_case(op_case)) check_operation(op_case, arguments.verbose, table);
  }
  for (const std::string_view name : kNetworkNames) {
    if (is_network(name)) check_network(name, arguments.verbose, table);
  }
  return table.finish();
}

}  // namespace

void add_gradcheck(CLI::App& app, Outcome& outcome) {
  const auto arguments = std::make_shared<GradcheckArguments>();
  CLI::App* command = app.add_subcommand(
      "gradcheck",
      "Compare gradients in float64 with difference quotients, on small shapes: relative error at most "
      "1e-6.\n"
      "Operations are compared with their naive references too (value: float64, float32).");
  command->add_option(
      "target", arguments->target,
      "An operation (conv2d), one of its cases (conv2d/k3_p1), a network (normal) or a config "
      "file, whose losses are checked in both stages; without it all operations and networks");
  command->add_flag("--verbose", arguments->verbose, "One line a tensor");
  command->add_option("--write-inputs", arguments->inputs,
                      "Write the operations' inputs for scripts/golden/ops.py, and check nothing");
  command->callback([arguments, &outcome] { outcome.exit_code = run_gradcheck(*arguments); });
}

}  // namespace opaline::cli
