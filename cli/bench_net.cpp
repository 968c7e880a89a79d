// `opaline bench net`: one whole network, its time beside its error, over sizes, threads and numerics.
#include <fmt/ranges.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "cli/bench.h"
#include "cli/bench_workload.h"
#include "cli/network_input.h"
#include "core/autograd.h"
#include "core/check/machine.h"
#include "core/clock.h"
#include "core/file.h"
#include "core/kernels/conv_plan.h"
#include "core/parallel.h"
#include "core/safetensors.h"
#include "data/chart.h"
#include "models/network.h"
#include "train/graph.h"

namespace opaline::cli {
namespace {

constexpr std::array kNumerics = {Numerics::kStrict, Numerics::kBalanced, Numerics::kFast};

struct NetArguments {
  std::string net;
  std::vector<int64_t> sizes{256};
  std::vector<int> threads;
  int64_t batch = 2;
  int64_t width = 64;
  int repeats = 3;
  std::filesystem::path weights, input;  // both or none
  std::string plot;
  bool json = false;
};

/// A network in training mode, what it reads and the gradient of its result.
struct Problem {
  std::unique_ptr<Network> network;
  Tensor x, cotangent;
};

/// In float32; with the tensors of the files where there are some.
Problem make_problem(const NetArguments& arguments, int64_t size) {
  Problem problem{make_network(arguments.net, {.image_size = size, .width = arguments.width}), Tensor(),
                  Tensor()};
  const std::string file = arguments.input.string();
  TensorMap tensors;
  if (file.empty()) {
    initialize_network(*problem.network, arguments.net, 1);
    problem.x = random_uniform(input_shape(arguments.net, arguments.batch, size), 0);
  } else {
    problem.network->load_state_dict(load_safetensors(arguments.weights).tensors,
                                     {.source = arguments.weights.string()});
    tensors = load_safetensors(file).tensors;
    problem.x = read_input(tensors, DType::kFloat32, file);
  }
  const NoGradGuard no_grad;
  const Tensor y = problem.network->forward(problem.x);
  problem.cotangent = file.empty() ? random_uniform(y.shape(), 1) : read_cotangent(tensors, y, file);
  return problem;
}

/// The same values in float64.
Problem widen(const Problem& problem, const NetArguments& arguments, int64_t size) {
  Problem wide{
      make_network(arguments.net, {.image_size = size, .width = arguments.width, .dtype = DType::kFloat64}),
      problem.x.to(DType::kFloat64), problem.cotangent.to(DType::kFloat64)};
  wide.network->load_state_dict(problem.network->state_dict());
  return wide;
}

struct Result {
  Tensor y, input_gradient;
  std::vector<Tensor> parameter_gradients;
};

Result run(const Problem& problem, Numerics numerics) {
  const NumericsGuard guard(numerics);
  Tensor x = problem.x.detach();
  x.set_requires_grad(true);
  const Tensor y = problem.network->forward(x);
  backward(y, problem.cotangent);
  Result result{y.detach(), x.grad(), {}};
  for (const NamedTensor& parameter : problem.network->named_parameters()) {
    result.parameter_gradients.push_back(parameter.tensor.grad());
  }
  problem.network->zero_grad();
  return result;
}

/// Root mean squares of differences, relative to the reference; those of the parameters' gradients over all
/// parameters together.
struct Errors {
  double result = 0.0, parameters = 0.0, input = 0.0;
};

Errors compare(const Result& value, const Result& reference) {
  RelativeError result, parameters, input;
  result.add(value.y, reference.y);
  input.add(value.input_gradient, reference.input_gradient);
  for (size_t i = 0; i < reference.parameter_gradients.size(); ++i) {
    parameters.add(value.parameter_gradients[i], reference.parameter_gradients[i]);
  }
  return {result.value(), parameters.value(), input.value()};
}

/// Medians of the forward pass alone, without graph, and of forward and backward.
struct Seconds {
  double forward = 0.0, step = 0.0;
};

/// The numerics take turns; the first turn fills the storage pool and is not timed.
std::array<Seconds, kNumerics.size()> measure(const Problem& problem, int repeats) {
  Network& network = *problem.network;
  std::array<std::shared_ptr<kernels::ConvPlan>, kNumerics.size()> plans;
  std::array<std::vector<double>, kNumerics.size()> forward, step;
  for (size_t k = 0; k < kNumerics.size(); ++k) {
    plans[k] = std::make_shared<kernels::ConvPlan>(kNumerics[k]);
  }
  for (int turn = -1; turn < repeats; ++turn) {
    for (size_t k = 0; k < kNumerics.size(); ++k) {
      const NumericsGuard guard(plans[k]);
      const double begin = wall_seconds();
      {
        const NoGradGuard no_grad;
        network.forward(problem.x);
      }
      const double middle = wall_seconds();
      backward(network.forward(problem.x), problem.cotangent);
      const double end = wall_seconds();
      network.zero_grad();
      if (turn < 0) continue;
      forward[k].push_back(middle - begin);
      step[k].push_back(end - middle);
    }
  }
  std::array<Seconds, kNumerics.size()> medians;
  for (size_t k = 0; k < kNumerics.size(); ++k) medians[k] = {median(forward[k]), median(step[k])};
  return medians;
}

/// A line of the table.
struct Row {
  int64_t size = 0;
  int threads = 0;
  Numerics numerics{};
  Seconds seconds;
  Errors errors;
  int64_t pixels = 0;                               ///< of all images
  double gflops = 0.0, gigabytes_per_second = 0.0;  ///< of a step, by count_work()
  double peak_share = 0.0, copy_share = 0.0;        ///< of what the machine can with as many threads
};

std::vector<Row> measure_size(const NetArguments& arguments, int64_t size,
                              const std::vector<Machine>& machines) {
  const Problem problem = make_problem(arguments, size);
  // Neither errors nor the reference depend on threads.
  std::array<Errors, kNumerics.size()> errors;
  {
    const Result reference = run(widen(problem, arguments, size), Numerics::kStrict);
    for (size_t k = 0; k < kNumerics.size(); ++k) errors[k] = compare(run(problem, kNumerics[k]), reference);
  }
  const WorkCount work = count_work(problem.network->forward(problem.x));
  const double flops = 2.0 * static_cast<double>(work.forward + work.backward);
  const auto bytes = static_cast<double>(work.forward_bytes + work.backward_bytes);
  const Tensor& x = problem.x;
  const int64_t pixels = x.size(0) * (x.dim() == 4 ? x.size(1) * x.size(2) : size * size);
  std::vector<Row> rows;
  for (size_t i = 0; i < machines.size(); ++i) {
    const ThreadsGuard guard(arguments.threads[i]);
    const auto seconds = measure(problem, arguments.repeats);
    for (size_t k = 0; k < kNumerics.size(); ++k) {
      const double gflops = 1e-9 * flops / seconds[k].step;
      const double gigabytes = 1e-9 * bytes / seconds[k].step;
      rows.push_back({.size = size,
                      .threads = arguments.threads[i],
                      .numerics = kNumerics[k],
                      .seconds = seconds[k],
                      .errors = errors[k],
                      .pixels = pixels,
                      .gflops = gflops,
                      .gigabytes_per_second = gigabytes,
                      .peak_share = gflops / machines[i].gflops,
                      .copy_share = gigabytes / machines[i].gigabytes_per_second});
    }
  }
  return rows;
}

void print_head(const NetArguments& arguments, const std::vector<Machine>& machines) {
  for (size_t i = 0; i < machines.size(); ++i) {
    fmt::print("{} threads, {}: {:.0f} GFLOP/s of fused multiply-adds, {:.1f} GB/s of copying\n",
               arguments.threads[i], machines[i].instruction_set, machines[i].gflops,
               machines[i].gigabytes_per_second);
  }
  fmt::print(
      "\n| size | threads | numerics | forward ms | step ms | GFLOP/s | of peak | GB/s | of copying | "
      "error of the result | of parameters' gradients | of the input's |\n"
      "|---:|---:|---|---:|---:|---:|---:|---:|---:|---:|---:|---:|\n");
}

void print_row(const Row& r) {
  fmt::print(
      "| {} | {} | {} | {:.1f} | {:.1f} | {:.0f} | {:.0f} % | {:.1f} | {:.0f} % | {:.1e} | {:.1e} | "
      "{:.1e} |\n",
      r.size, r.threads, to_string(r.numerics), 1e3 * r.seconds.forward, 1e3 * r.seconds.step, r.gflops,
      100.0 * r.peak_share, r.gigabytes_per_second, 100.0 * r.copy_share, r.errors.result,
      r.errors.parameters, r.errors.input);
  std::fflush(stdout);
}

nlohmann::ordered_json to_json(const std::vector<Row>& rows, const NetArguments& arguments) {
  nlohmann::ordered_json json = {{"net", arguments.net}, {"width", arguments.width}};
  for (const Row& r : rows) {
    json["rows"].push_back({{"size", r.size},
                            {"threads", r.threads},
                            {"numerics", to_string(r.numerics)},
                            {"pixels", r.pixels},
                            {"forward_seconds", r.seconds.forward},
                            {"step_seconds", r.seconds.step},
                            {"gflops", r.gflops},
                            {"peak_share", r.peak_share},
                            {"gigabytes_per_second", r.gigabytes_per_second},
                            {"copy_share", r.copy_share},
                            {"result_error", r.errors.result},
                            {"parameter_gradient_error", r.errors.parameters},
                            {"input_gradient_error", r.errors.input}});
  }
  return json;
}

std::string colour_of(size_t numerics, size_t paler) {
  constexpr std::array kHues = {213, 25, 130};
  return fmt::format("hsl({},65%,{}%)", kHues[numerics], std::min<size_t>(38 + 22 * paler, 82));
}

/// A series for numerics and threads, of `point`s of their rows; paler with fewer threads.
template <class Point>
std::vector<ChartSeries> series_of(const std::vector<Row>& rows, const std::vector<int>& threads,
                                   const Point& point) {
  std::vector<ChartSeries> series;
  for (size_t i = 0; i < threads.size(); ++i) {
    for (size_t k = 0; k < kNumerics.size(); ++k) {
      ChartSeries& one = series.emplace_back();
      one.name = fmt::format("{} x{}", to_string(kNumerics[k]), threads[i]);
      one.colour = colour_of(k, threads.size() - 1 - i);
      one.markers = true;
      for (const Row& row : rows) {
        if (row.threads == threads[i] && row.numerics == kNumerics[k]) one.points.push_back(point(row));
      }
    }
  }
  return series;
}

/// Errors over the size, which are those of any number of threads.
std::vector<ChartSeries> error_series(const std::vector<Row>& rows, int threads) {
  std::vector<ChartSeries> series(2 * kNumerics.size());
  for (size_t k = 0; k < kNumerics.size(); ++k) {
    ChartSeries& result = series[k];
    ChartSeries& gradients = series[kNumerics.size() + k];
    result = {std::string(to_string(kNumerics[k])), colour_of(k, 1), {}, true};
    gradients = {fmt::format("{}: grad", to_string(kNumerics[k])), colour_of(k, 0), {}, true};
    for (const Row& row : rows) {
      if (row.threads != threads || row.numerics != kNumerics[k]) continue;
      result.points.push_back({static_cast<double>(row.size), row.errors.result});
      gradients.points.push_back({static_cast<double>(row.size), row.errors.parameters});
    }
  }
  return series;
}

/// Rates and errors over the size, and the error of the result over the time of a step.
std::string plot(const std::vector<Row>& rows, const std::vector<int>& threads) {
  constexpr int kWidth = 760, kHeight = 220;
  const auto over_size = [](std::string title, bool log_y) {
    return ChartOptions{.title = std::move(title),
                        .x_label = "image size",
                        .log_x = true,
                        .log_y = log_y,
                        .width = kWidth,
                        .height = kHeight};
  };
  const auto gflops = series_of(rows, threads, [](const Row& row) {
    return ChartPoint{static_cast<double>(row.size), row.gflops};
  });
  const auto bytes = series_of(rows, threads, [](const Row& row) {
    return ChartPoint{static_cast<double>(row.size), row.gigabytes_per_second};
  });
  const auto errors = series_of(rows, threads, [](const Row& row) {
    return ChartPoint{1e9 * row.seconds.step / static_cast<double>(row.pixels), row.errors.result};
  });
  return chart_sheet({render_chart(gflops, over_size("GFLOP/s, direct count", false)),
                      render_chart(bytes, over_size("GB/s", false)),
                      render_chart(error_series(rows, threads.back()),
                                   over_size("Error of the result and of gradients", true)),
                      render_chart(errors, {.title = "Error of the result over time",
                                            .x_label = "nanoseconds a pixel, forward and backward",
                                            .log_x = true,
                                            .log_y = true,
                                            .lines = false,
                                            .width = kWidth,
                                            .height = kHeight})},
                     1, kWidth, kHeight);
}

void run_bench_net(NetArguments arguments) {
  if (!arguments.input.empty() && arguments.sizes.size() != 1) {
    fail_usage("bench net", "weights of a file are of one build size: give one --size");
  }
  if (arguments.threads.empty()) arguments.threads = {num_threads()};
  std::vector<Machine> machines;
  for (const int threads : arguments.threads) {
    const ThreadsGuard guard(threads);
    machines.push_back(measure_machine());
  }
  std::vector<Row> rows;
  for (const int64_t size : arguments.sizes) {
    const std::vector<Row> measured = measure_size(arguments, size, machines);
    if (!arguments.json && rows.empty()) print_head(arguments, machines);
    for (const Row& row : measured) {
      if (!arguments.json) print_row(row);
      rows.push_back(row);
    }
  }
  if (arguments.json) fmt::print("{}\n", to_json(rows, arguments).dump());
  if (!arguments.plot.empty()) write_file_atomically(arguments.plot, plot(rows, arguments.threads));
}

}  // namespace

void add_bench_net(CLI::App& bench) {
  const auto arguments = std::make_shared<NetArguments>();
  CLI::App* command = bench.add_subcommand(
      "net",
      "Time the forward pass, and forward and backward, of one network in training mode by every numerics: "
      "medians, taking\n"
      "turns; the rate by the direct-convolution count and in bytes that must move, and their share of the "
      "machine's peaks;\n"
      "root-mean-square errors of the result and of the gradients against float64, relative to these.");
  command->add_option("--net", arguments->net, fmt::format("One of {}", fmt::join(kNetworkNames, ", ")))
      ->required()
      ->check(CLI::IsMember(std::vector<std::string>(kNetworkNames.begin(), kNetworkNames.end())));
  command->add_option("--size", arguments->sizes, "Image sizes")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--threads", arguments->threads, "Numbers of threads (default: all cores)")
      ->check(CLI::PositiveNumber);
  CLI::Option* batch =
      command->add_option("--batch", arguments->batch, "Images; networks that end in a vector need several")
          ->check(CLI::PositiveNumber)
          ->capture_default_str();
  command->add_option("--width", arguments->width, "Channels of the first layer")->capture_default_str();
  command->add_option("--repeats", arguments->repeats, "Timed turns after one warm-up")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  CLI::Option* weights = command->add_option(
      "--weights", arguments->weights,
      "Weights, safetensors with PyTorch's names; rounded to float32 (default: fresh ones)");
  command
      ->add_option("--input", arguments->input,
                   "safetensors with 'x' and 'cotangent' as for opaline forward (default: noise)")
      ->needs(weights)
      ->excludes(batch);
  weights->needs(command->get_option("--input"));
  command->add_flag("--json", arguments->json, "Print one JSON object");
  command->add_option("--plot", arguments->plot, "Write charts of rates and errors to this SVG file");
  command->callback([arguments] { run_bench_net(*arguments); });
}

}  // namespace opaline::cli
