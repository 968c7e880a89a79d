// `opaline bench step`: time, work and memory of one training step or forward pass.
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "cli/bench.h"
#include "cli/bench_workload.h"
#include "cli/numerics_option.h"
#include "core/autograd.h"
#include "core/clock.h"
#include "core/error.h"
#include "core/memory.h"
#include "core/numerics.h"
#include "train/graph.h"

namespace opaline::cli {
namespace {

struct BenchArguments {
  Workload workload;
  int64_t repeats = 3;
  Numerics numerics = Numerics::kBalanced;
  bool forward_only = false;
  bool json = false;
};

void run_bench_step(const BenchArguments& arguments) {
  const Workload& workload = arguments.workload;
  if (workload.net == "cascade" && !arguments.forward_only) {
    fail_usage("bench step", "cascade is what prediction computes: it needs --forward");
  }
  const std::unique_ptr<Step> step = make_step(workload);

  // The forward pass alone is what prediction runs: with running statistics, so that one image will do.
  step->set_training(!arguments.forward_only);

  const int64_t before = tensor_pool().bytes_in_use();
  int64_t gradients = 0;
  for (const NamedTensor& parameter : step->parameters()) gradients += parameter.tensor.byte_size();
  if (arguments.forward_only) gradients = 0;

  const NumericsGuard numerics(arguments.numerics);
  // The warm-up fills the pool and, because it records, tells the work.
  WorkCount work;
  {
    const Tensor result = step->forward();
    work = count_work(result);
    if (!arguments.forward_only) step->go_backward(result);
  }
  step->zero_grad();
  tensor_pool().release_cached();
  tensor_pool().reset_peak();

  std::vector<double> seconds;
  // The first run after the release fills the pool again, and is not timed.
  for (int64_t i = -1; i < arguments.repeats; ++i) {
    const double begin = wall_seconds();
    if (arguments.forward_only) {
      const NoGradGuard no_grad;
      step->forward();
    } else {
      step->go_backward(step->forward());
    }
    if (i >= 0) seconds.push_back(wall_seconds() - begin);
    step->zero_grad();
  }
  const double middle = median(seconds);
  const int64_t macs = work.forward + (arguments.forward_only ? 0 : work.backward);
  const double gflops = 2e-9 * static_cast<double>(macs) / middle;
  const int64_t peak = tensor_pool().peak_bytes();
  if (arguments.json) {
    const nlohmann::ordered_json json = {{"seconds", middle},
                                         {"gflops", gflops},
                                         {"peak_bytes", peak},
                                         {"beyond_parameters_bytes", peak - before - gradients}};
    fmt::print("{}\n", json.dump());
  } else {
    fmt::print(
        "{} {}, {} x {} x {}: {:.4g} s, {:.4g} GFLOP/s ({:.4g} GMAC), peak {:.4g} MiB, of "
        "which {:.4g} beyond weights, gradients and inputs\n",
        workload.net, arguments.forward_only ? "forward" : "forward and backward", workload.batch,
        workload.size, workload.size, middle, gflops, 1e-9 * static_cast<double>(macs),
        static_cast<double>(peak) / (1 << 20), static_cast<double>(peak - before - gradients) / (1 << 20));
  }
}

}  // namespace

void add_bench_step(CLI::App& bench) {
  const auto arguments = std::make_shared<BenchArguments>();
  CLI::App* command =
      bench.add_subcommand("step",
                           "Time the forward and backward pass of one network or stage, without the "
                           "optimiser: the median, the rate\n"
                           "by the direct-convolution count, and the peak of the storage pool.");
  const std::vector<std::string> nets = workload_names();
  command->add_option("--net", arguments->workload.net, fmt::format("One of {}", fmt::join(nets, ", ")))
      ->required()
      ->check(CLI::IsMember(nets));
  command->add_option("--size", arguments->workload.size, "Image size")->capture_default_str();
  command->add_option("--batch", arguments->workload.batch, "Images")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--width", arguments->workload.width, "Channels of the first layer")
      ->capture_default_str();
  command->add_option(
      "--mask", arguments->workload.mask,
      "The object's pixels: a PNG, or a coverage such as 0.3 (a disc). Of a stage, the losses are over it");
  command->add_flag("--skip", arguments->workload.skip,
                    "Compute on the 16 x 16 tiles that touch the mask alone");
  command->add_option("--repeats", arguments->repeats, "Timed repetitions after one warm-up")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  add_numerics_option(*command, arguments->numerics);
  command->add_flag("--forward", arguments->forward_only, "The forward pass alone, in evaluation mode");
  command->add_flag("--json", arguments->json, "Print one JSON object");
  command->callback([arguments] { run_bench_step(*arguments); });
}

}  // namespace opaline::cli
