#include "cli/bench_conv.h"

#include <algorithm>
#include <functional>
#include <memory>

#include "cli/bench.h"
#include "cli/bench_workload.h"
#include "core/check/machine.h"
#include "core/clock.h"
#include "core/kernels/direct.h"
#include "core/kernels/winograd.h"
#include "core/parallel.h"

namespace opaline::cli {
namespace {

using kernels::ConvPass;
using kernels::ConvShape;

constexpr ConvPass kPasses[] = {ConvPass::kForward, ConvPass::kInputGradient, ConvPass::kWeightGradient};

/// One pass by one algorithm. With a reflecting border the input gradient includes its folding.
template <class T>
Tensor run_conv(const ConvData& data, ConvPass pass, int outputs) {
  const ConvShape& s = data.shape;
  const T* const x = data.x.data<T>();
  const T* const w = data.weight.data<T>();
  const T* const dy = data.dy.data<T>();
  const DType dtype = dtype_of<T>();
  const T* const none = nullptr;
  const kernels::Part<const T> in{x, s.in};
  if (pass == ConvPass::kForward) {
    Tensor y({s.n, s.out_h(), s.out_w(), s.out}, dtype);
    if (outputs == 0) {
      kernels::direct_forward(s, x, w, none, y.data<T>());
    } else {
      kernels::winograd_forward<T>(outputs, s, {&in, 1}, w, none, y.data<T>());
    }
    return y;
  }
  if (pass == ConvPass::kInputGradient) {
    const int64_t border = s.reflect ? s.padding : 0;
    Tensor padded({s.n, s.h + 2 * border, s.w + 2 * border, s.in}, dtype);
    if (outputs == 0) {
      kernels::direct_input_gradient(s, dy, w, none, padded.data<T>());
    } else {
      const kernels::Part<T> whole{padded.data<T>(), s.in};
      kernels::winograd_input_gradient<T>(outputs, s, dy, w, none, {&whole, 1});
    }
    if (border == 0) return padded;
    Tensor dx({s.n, s.h, s.w, s.in}, dtype);
    kernels::fold_reflection(
        kernels::Image<T>{padded.data<T>(), s.n, s.h + 2 * border, s.w + 2 * border, s.in}, border,
        dx.data<T>());
    return dx;
  }
  Tensor dw({s.out, s.in, s.kernel_h, s.kernel_w}, dtype);
  if (outputs == 0) {
    kernels::direct_weight_gradient(s, x, dy, dw.data<T>());
  } else {
    kernels::winograd_weight_gradient<T>(outputs, s, {&in, 1}, dy, dw.data<T>());
  }
  return dw;
}

/// The numerics that choose this algorithm.
std::vector<std::string_view> chosen_by(const ConvShape& s, const ConvTiming& t) {
  std::vector<std::string_view> names;
  for (const Numerics numerics : {Numerics::kStrict, Numerics::kBalanced, Numerics::kFast}) {
    if (kernels::choose_algorithm(s, t.pass, numerics) == t.outputs) names.push_back(to_string(numerics));
  }
  return names;
}

struct Arguments {
  ConvShape shape{.n = 2, .h = 64, .w = 64, .in = 256, .out = 256, .kernel_h = 3, .kernel_w = 3};
  int64_t size = 64, kernel = 3;
  int repeats = 5;
};

void run_bench_conv(Arguments arguments) {
  ConvShape& s = arguments.shape;
  s.h = s.w = arguments.size;
  s.kernel_h = s.kernel_w = arguments.kernel;
  s.padding = arguments.kernel / 2;
  ConvData data{.shape = s,
                .x = random_normal({s.n, s.h, s.w, s.in}, 0),
                .weight = random_normal({s.out, s.in, s.kernel_h, s.kernel_w}, 1, 0.02),
                .dy = random_normal({s.n, s.out_h(), s.out_w(), s.out}, 2)};
  // What follows a rectifier is positive.
  for (float& value : data.x.values<float>()) value = std::max(value, 0.0F);
  const Machine machine = measure_machine();
  fmt::print("{} x {} x {} x {} -> {}, kernel {}, stride {}; {} threads, {}: {:.0f} GFLOP/s\n", s.n, s.h, s.w,
             s.in, s.out, s.kernel_h, s.stride, num_threads(), machine.instruction_set, machine.gflops);
  fmt::print("| {:<15} | {:<8} | {:>9} | {:>8} | {:>6} | {:>8} | {:<20} |\n", "pass", "way", "ms", "GFLOP/s",
             "peak", "error", "choice of");
  fmt::print("|{:-<17}|{:-<10}|{:->10}:|{:->9}:|{:->7}:|{:->9}:|{:-<22}|\n", "", "", "", "", "", "", "");
  for (const ConvTiming& t : measure_conv(data, arguments.repeats)) {
    fmt::print("| {:<15} | {:<8} | {:>9.3f} | {:>8.0f} | {:>4.0f} % | {:>8.1e} | {:<20} |\n",
               to_string(t.pass), algorithm_name(t.outputs), 1e3 * t.seconds, t.gflops,
               100.0 * t.gflops / machine.gflops, t.error,
               fmt::format("{}", fmt::join(chosen_by(s, t), ", ")));
  }
}

}  // namespace

std::vector<ConvTiming> measure_conv(const ConvData& data, int repeats) {
  const ConvShape& s = data.shape;
  const ConvData wide{.shape = s,
                      .x = data.x.to(DType::kFloat64),
                      .weight = data.weight.to(DType::kFloat64),
                      .dy = data.dy.to(DType::kFloat64)};
  std::vector<int> algorithms{0};
  for (const int outputs : {2, 3, 4, 6}) {
    if (kernels::winograd_fits(s, outputs)) algorithms.push_back(outputs);
  }
  const double work = 2e-9 * static_cast<double>(data.dy.numel() * data.weight.numel() / s.out);
  std::vector<ConvTiming> timings;
  for (const ConvPass pass : kPasses) {
    const Tensor reference = run_conv<double>(wide, pass, 0);
    const size_t first = timings.size();
    for (const int outputs : algorithms) {
      RelativeError error;
      error.add(run_conv<float>(data, pass, outputs), reference);
      timings.push_back({.pass = pass, .outputs = outputs, .error = error.value()});
    }
    std::vector<std::vector<double>> seconds(algorithms.size());
    for (int i = 0; i < repeats; ++i) {
      for (size_t k = 0; k < algorithms.size(); ++k) {
        const double begin = wall_seconds();
        run_conv<float>(data, pass, algorithms[k]);
        seconds[k].push_back(wall_seconds() - begin);
      }
    }
    for (size_t k = 0; k < algorithms.size(); ++k) {
      timings[first + k].seconds = median(seconds[k]);
      timings[first + k].gflops = work / timings[first + k].seconds;
    }
  }
  return timings;
}

std::string algorithm_name(int outputs) {
  if (outputs == 3) return "F(3x3, 4x4)";
  return outputs == 0 ? "direct" : fmt::format("F({0}x{0})", outputs);
}

void add_bench_conv(CLI::App& bench) {
  const auto arguments = std::make_shared<Arguments>();
  CLI::App* command = bench.add_subcommand(
      "conv",
      "Time the three passes of one convolution by every algorithm that fits it: medians, taking turns; the "
      "rate "
      "by the direct count;\n"
      "the root-mean-square error against float64, relative to the result. Padding is half the kernel.");
  command->add_option("--batch", arguments->shape.n, "Images")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--size", arguments->size, "Side of the images")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--in", arguments->shape.in, "Input channels")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--out", arguments->shape.out, "Output channels")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--kernel", arguments->kernel, "Side of the kernel")
      ->check(CLI::Range(1, 15))
      ->capture_default_str();
  command->add_option("--stride", arguments->shape.stride, "Stride")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--repeats", arguments->repeats, "Turns of each algorithm")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->callback([arguments] { run_bench_conv(*arguments); });
}

}  // namespace opaline::cli
