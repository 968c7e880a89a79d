// bench_ops: time of every operation on the sizes of real layers, and its error beside it.
#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <cstdio>
#include <string>
#include <vector>

#include "core/autograd.h"
#include "core/check/machine.h"
#include "core/check/op_case.h"
#include "core/check/run.h"
#include "core/instruction_set.h"
#include "core/parallel.h"
#include "train/graph.h"

namespace opaline::bench {
namespace {

struct Arguments {
  int64_t side = 256;
  int threads = 0;
  double seconds = 0.5;
  std::string only;
};

/// Medians of one operation, in seconds, and what it did.
struct Timing {
  double forward = 0.0;
  double backward = 0.0;
  WorkCount work;
  int64_t forward_bytes = 0;   ///< inputs and result, each once
  int64_t backward_bytes = 0;  ///< inputs, the result's gradient and theirs, each once
};

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

double seconds_since(std::chrono::steady_clock::time_point begin) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

/// Repeats for about `seconds`, at least three times, after one run that warms the pool.
Timing measure(const check::OpCase& op_case, double seconds) {
  std::vector<Tensor> inputs = check::make_inputs(op_case, DType::kFloat32);
  Timing timing;
  Tensor cotangent;
  std::vector<double> forward, backward_times;
  const auto begin = std::chrono::steady_clock::now();
  for (int run = -1; run < 3 || seconds_since(begin) < seconds; ++run) {
    for (Tensor& input : inputs) input.zero_grad();
    const auto before = std::chrono::steady_clock::now();
    const Tensor y = op_case.forward(inputs);
    const double forward_seconds = seconds_since(before);
    if (run < 0) {
      timing.work = count_work(y);
      cotangent = check::make_cotangent(op_case, y.shape(), DType::kFloat32);
      timing.forward_bytes = y.byte_size();
      timing.backward_bytes = y.byte_size();
      for (size_t i = 0; i < inputs.size(); ++i) {
        timing.forward_bytes += inputs[i].byte_size();
        timing.backward_bytes += inputs[i].byte_size() * (op_case.inputs[i].differentiable ? 2 : 1);
      }
    }
    const auto middle = std::chrono::steady_clock::now();
    backward(y, cotangent);
    if (run < 0) continue;
    forward.push_back(forward_seconds);
    backward_times.push_back(seconds_since(middle));
  }
  timing.forward = median(forward);
  timing.backward = median(backward_times);
  return timing;
}

/// "123 GFLOP/s  78 %" where the operation multiplies, "12 GB/s  80 %" where it moves.
std::string rate(double seconds, int64_t multiply_adds, int64_t bytes, const Machine& machine) {
  if (multiply_adds > 0) {
    const double gflops = 2e-9 * static_cast<double>(multiply_adds) / seconds;
    return fmt::format("{:6.1f} GFLOP/s {:3.0f} %", gflops, 100.0 * gflops / machine.gflops);
  }
  const double gigabytes = 1e-9 * static_cast<double>(bytes) / seconds;
  return fmt::format("{:6.1f} GB/s    {:3.0f} %", gigabytes,
                     100.0 * gigabytes / machine.gigabytes_per_second);
}

std::string input_shapes(const check::OpCase& op_case) {
  std::vector<std::string> shapes;
  for (const check::InputSpec& spec : op_case.inputs) shapes.push_back(to_string(spec.shape));
  return fmt::format("{}", fmt::join(shapes, ", "));
}

void run(const Arguments& arguments) {
  set_num_threads(arguments.threads);
  const Machine machine = measure_machine();
  fmt::print("float32, {} threads, {}: {:.1f} GFLOP/s of fused multiply-adds, {:.1f} GB/s of copying\n\n",
             num_threads(), machine.instruction_set, machine.gflops, machine.gigabytes_per_second);
  fmt::print("| {:<30} | {:<34} | {:>10} | {:<21} | {:>11} | {:<21} | {:>7} |\n", "operation", "inputs",
             "forward ms", "rate, share of peak", "backward ms", "rate, share of peak", "error");
  fmt::print("|{:-<32}|{:-<36}|{:-<11}:|{:-<23}|{:-<12}:|{:-<23}|{:-<8}:|\n", "", "", "", "", "", "", "");
  for (const check::OpCase& op_case : check::large_op_cases(arguments.side)) {
    if (!arguments.only.empty() && op_case.operation() != arguments.only) continue;
    const Timing t = measure(op_case, arguments.seconds);
    const double error = check::reference_error(op_case, check::run_case(op_case, DType::kFloat32));
    fmt::print("| {:<30} | {:<34} | {:>10.3f} | {:<21} | {:>11.3f} | {:<21} | {:>7.1e} |\n", op_case.name,
               input_shapes(op_case), 1e3 * t.forward,
               rate(t.forward, t.work.forward, t.forward_bytes, machine), 1e3 * t.backward,
               rate(t.backward, t.work.backward, t.backward_bytes, machine), error);
    std::fflush(stdout);
  }
}

}  // namespace
}  // namespace opaline::bench

int main(int argc, char** argv) {
  CLI::App app{
      "Time of operations on the sizes of real layers: medians of the forward and the backward pass, the "
      "rate (by\n"
      "the direct count of multiply-adds, or bytes of inputs and results) and its share of what the machine\n"
      "measured, and the largest error against the naive float64 reference, over the largest value"};
  opaline::bench::Arguments arguments;
  app.add_option("--side", arguments.side, "Side of the images; a multiple of 8")
      ->check(CLI::Range(16, 1024))
      ->capture_default_str();
  app.add_option("--threads", arguments.threads, "0: all cores")->capture_default_str();
  app.add_option("--seconds", arguments.seconds, "Time spent on one operation")->capture_default_str();
  app.add_option("--op", arguments.only, "One operation alone");
  CLI11_PARSE(app, argc, argv);
  try {
    opaline::limit_instruction_set();
    opaline::bench::run(arguments);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_ops: %s\n", error.what());
    return 1;
  }
  return 0;
}
