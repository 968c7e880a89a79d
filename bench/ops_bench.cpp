// Time beside error for every operation: forward and backward medians at the networks' channel counts, the
// share of the machine's limit, and the error of float32 against the naive float64 reference at the same
// size.
//
//   cmake --preset release -DOPALINE_BUILD_BENCH=ON && cmake --build --preset release --target bench_ops
//   build/release/bench_ops [--side 64] [--threads 2] [--filter conv2d]
#include <fmt/format.h>

#include <CLI/CLI.hpp>
#include <algorithm>
#include <chrono>
#include <string>
#include <vector>

#include "bench/machine.h"
#include "core/autograd.h"
#include "core/check/op_case.h"
#include "core/check/run.h"
#include "core/parallel.h"
#include "train/graph.h"

namespace {

using namespace opaline;

struct Timing {
  double forward = 0, backward = 0;  // medians, seconds
  WorkCount work;
  double forward_bytes = 0;  // inputs and result, once each
};

double median(std::vector<double> values) {
  const auto middle = values.begin() + static_cast<std::ptrdiff_t>(values.size() / 2);
  std::nth_element(values.begin(), middle, values.end());
  return *middle;
}

double since(std::chrono::steady_clock::time_point begin) {
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

Timing time_case(const check::OpCase& op_case, int repeats) {
  std::vector<Tensor> inputs = check::make_inputs(op_case, DType::kFloat32);
  Timing timing;
  std::vector<double> forward, backward;
  Tensor cotangent;
  for (int i = 0; i <= repeats; ++i) {  // the first fills the pool and counts the work
    const auto begin = std::chrono::steady_clock::now();
    const Tensor y = op_case.forward(inputs);
    const double forward_seconds = since(begin);
    if (i == 0) {
      timing.work = count_work(y);
      timing.forward_bytes = static_cast<double>(y.byte_size());
      for (const Tensor& input : inputs) timing.forward_bytes += static_cast<double>(input.byte_size());
      cotangent = check::make_cotangent(op_case, y.shape(), DType::kFloat32);
    }
    const auto middle = std::chrono::steady_clock::now();
    if (y.requires_grad()) opaline::backward(y, cotangent);
    const double backward_seconds = since(middle);
    for (Tensor& input : inputs) input.zero_grad();
    if (i == 0) continue;
    forward.push_back(forward_seconds);
    backward.push_back(backward_seconds);
  }
  timing.forward = median(forward);
  timing.backward = median(backward);
  return timing;
}

std::string rate(int64_t macs, double bytes, double seconds, const bench::MachineLimits& limits) {
  if (macs > 0) {
    const double gflops = 2e-9 * static_cast<double>(macs) / seconds;
    return fmt::format("{:7.1f} GFLOP/s {:3.0f} %", gflops, 100.0 * gflops / limits.gflops);
  }
  const double speed = 1e-9 * bytes / seconds;
  return fmt::format("{:7.1f} GB/s    {:3.0f} %", speed, 100.0 * speed / limits.gigabytes_per_second);
}

int run(int argc, char** argv) {
  CLI::App app{"Time and error of every operation"};
  int64_t side = 64;
  int threads = 0, repeats = 7;
  std::string filter;
  app.add_option("--side", side, "Images are side x side")->capture_default_str();
  app.add_option("--threads", threads, "0: all cores")->capture_default_str();
  app.add_option("--repeats", repeats, "Timed repetitions")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  app.add_option("--filter", filter, "Only cases whose name holds this");
  CLI11_PARSE(app, argc, argv);
  set_num_threads(threads);

  const bench::MachineLimits limits = bench::measure_machine();
  fmt::print("{} threads, {}, {:.0f} GFLOP/s, {:.1f} GB/s; images {} x {}; medians of {}\n", num_threads(),
             limits.instruction_set, limits.gflops, limits.gigabytes_per_second, side, side, repeats);
  fmt::print("{:<34} {:>10} {:>22} {:>10} {:>22} {:>10}\n", "case", "forward ms", "share of the limit",
             "backw. ms", "share of the limit", "error");
  for (const check::OpCase& op_case : check::large_op_cases(side)) {
    if (op_case.name.find(filter) == std::string::npos) continue;
    // Correct first: what is wrong is not worth timing.
    const double error = check::reference_error(op_case, check::run_case(op_case, DType::kFloat32));
    if (!(error <= op_case.tolerances.float32)) {
      fmt::print("{:<34} error {:.1e} over its limit {:.1e}\n", op_case.name, error,
                 op_case.tolerances.float32);
      return 1;
    }
    const Timing t = time_case(op_case, repeats);
    fmt::print("{:<34} {:>10.3f} {:>22} {:>10.3f} {:>22} {:>10.1e}\n", op_case.name, 1e3 * t.forward,
               rate(t.work.forward, t.forward_bytes, t.forward, limits), 1e3 * t.backward,
               rate(t.work.backward, 2.0 * t.forward_bytes, t.backward, limits), error);
  }
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    return run(argc, argv);
  } catch (const std::exception& error) {
    fmt::print(stderr, "bench_ops: {}\n", error.what());
    return 1;
  }
}
