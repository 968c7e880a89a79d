// `opaline bench layers`: every convolution of a network on the activations and gradients that it really
// sees.
#include <fmt/ranges.h>

#include <algorithm>
#include <map>
#include <memory>
#include <nlohmann/json.hpp>
#include <optional>
#include <set>
#include <string>
#include <vector>

#include "cli/bench.h"
#include "cli/bench_conv.h"
#include "cli/bench_workload.h"
#include "core/autograd.h"
#include "core/check/machine.h"
#include "core/file.h"
#include "core/kernels/conv_plan.h"
#include "core/ops/shape.h"
#include "core/parallel.h"
#include "data/chart.h"
#include "data/dataset.h"
#include "data/loader.h"
#include "models/cascade.h"
#include "train/graph.h"
#include "train/losses.h"
#include "train/stage.h"
#include "train/trained_model.h"

namespace opaline::cli {
namespace {

using kernels::ConvPass;
using kernels::ConvShape;

struct LayersArguments {
  std::string net;
  std::filesystem::path run;
  int64_t size = 256;
  int64_t batch = 2;
  int64_t width = 64;
  int repeats = 3;
  std::string plot;
};

struct Layer {
  std::string name;
  ConvData data;
};

/// The shape of a recorded convolution. A node does not hold the stride and the border; they follow from the
/// sizes, and whether the border is mirrored from the choices that the forward pass made.
ConvShape recorded_shape(const Tensor& x, int64_t channels, const Tensor& weight, const Tensor& y,
                         const std::set<std::string>& chosen) {
  ConvShape s{.n = x.size(0),
              .h = x.size(1),
              .w = x.size(2),
              .in = channels,
              .out = weight.size(0),
              .kernel_h = weight.size(2),
              .kernel_w = weight.size(3)};
  s.stride = (s.h + y.size(1) - 1) / y.size(1);
  s.padding = s.kernel_h / 2;
  s.reflect = !chosen.contains(to_string(s));
  if (!chosen.contains(to_string(s))) {
    fail("bench layers", "the convolution from {} to {} is of no kind that networks here have",
         to_string(x.shape()), to_string(y.shape()));
  }
  return s;
}

std::set<std::string> chosen_shapes(const kernels::ConvPlan& plan) {
  const auto json = nlohmann::json::parse(plan.to_json());
  std::set<std::string> names;
  for (const auto& [shape, passes] : json.at("convolutions").items()) names.insert(shape);
  return names;
}

/// Goes from what `forward` computes back to its inputs and keeps what every convolution reads on the way. A
/// result that is no scalar is given a random gradient.
template <class Forward>
std::vector<Layer> capture(const std::vector<NamedTensor>& parameters, const Forward& forward) {
  std::map<const void*, std::string> names;
  for (const NamedTensor& parameter : parameters) names[parameter.tensor.id()] = parameter.name;
  const auto plan = std::make_shared<kernels::ConvPlan>(Numerics::kStrict);
  const NumericsGuard guard(plan);
  const Tensor y = forward();
  const std::set<std::string> chosen = chosen_shapes(*plan);
  std::vector<Layer> layers;
  for (const Tensor& result : computation_order(y)) {
    const std::shared_ptr<Node> node = result.node();
    if (!node || node->operation != "conv2d") continue;
    const size_t parts = node->inputs.size() - 2;
    std::vector<Tensor> values;
    for (size_t i = 0; i < parts; ++i) values.push_back(node->inputs[i].restored());
    const Tensor weight = node->inputs[parts].restored();
    const NoGradGuard no_grad;
    const Tensor x = parts == 1 ? values.front().clone() : concat(values, 3);
    const size_t index = layers.size();
    layers.push_back({names.at(node->inputs[parts].id()),
                      {recorded_shape(x, x.size(3), weight, result, chosen), x, weight.clone(), {}}});
    node->backward = [&layers, index, inner = node->backward](const Tensor& dy, std::span<const char> needs) {
      layers[index].data.dy = dy.clone();
      return inner(dy, needs);
    };
  }
  if (y.numel() == 1) {
    backward(y);
    return layers;
  }
  backward(y, random_normal(y.shape(), 9));
  return layers;
}

/// Bounds of the three numerics for a pass: where cancellation lifts plain direct sums over the strict one,
/// twice, 10 and 100 times their error count.
double bound(Numerics numerics, double direct_error) {
  switch (numerics) {
    case Numerics::kStrict:
      return std::max(5e-7, 2.0 * direct_error);
    case Numerics::kBalanced:
      return std::max(3e-6, 10.0 * direct_error);
    case Numerics::kFast:
      return std::max(3e-5, 100.0 * direct_error);
  }
  return 0.0;
}

/// Operations by the direct count over the bytes of input, weight and result, each once: the same for the
/// three passes, of which each reads two of them and writes the third.
double intensity(const ConvData& data) {
  const int64_t operations = 2 * data.dy.numel() * (data.weight.numel() / data.shape.out);
  const int64_t bytes = data.x.byte_size() + data.weight.byte_size() + data.dy.byte_size();
  return static_cast<double>(operations) / static_cast<double>(bytes);
}

/// What layers attain by the algorithms that numerics choose, over their intensity.
using Points = std::map<Numerics, std::vector<ChartPoint>>;

/// With the machine's roof, which Winograd's algorithm may pass: it saves operations that the direct count
/// has.
std::string draw_roofline(const Points& points, const Machine& machine) {
  constexpr int kWidth = 720, kHeight = 420;
  const std::map<Numerics, std::string> colours = {
      {Numerics::kStrict, "#1f5fa8"}, {Numerics::kBalanced, "#c2532d"}, {Numerics::kFast, "#2e8b57"}};
  const double ridge = machine.gflops / machine.gigabytes_per_second;
  double low = ridge, high = ridge;
  std::vector<ChartSeries> series;
  for (const auto& [numerics, attained] : points) {
    for (const ChartPoint& point : attained) {
      low = std::min(low, point.x);
      high = std::max(high, point.x);
    }
    series.push_back({.name = std::string(to_string(numerics)),
                      .colour = colours.at(numerics),
                      .points = attained,
                      .line = false});
  }
  series.push_back(
      {.name = "roof",
       .colour = "#5a6876",
       .points = {
           {low, low * machine.gigabytes_per_second}, {ridge, machine.gflops}, {high, machine.gflops}}});
  return chart_sheet({render_chart(series, {.title = "Convolutions: GFLOP/s, direct count",
                                            .x_label = "FLOP a byte of input, weight and result",
                                            .log_x = true,
                                            .log_y = true,
                                            .width = kWidth,
                                            .height = kHeight})},
                     1, kWidth, kHeight);
}

/// A network with fresh weights on noise.
std::vector<Layer> layers_of_network(const LayersArguments& arguments) {
  const std::unique_ptr<Network> network =
      make_network(arguments.net, {.image_size = arguments.size, .width = arguments.width});
  initialize_network(*network, arguments.net, 1);
  const Tensor x = random_uniform(input_shape(arguments.net, arguments.batch, arguments.size), 0);
  return capture(network->named_parameters(), [&] { return network->forward(x); });
}

/// All networks of a run, in a training step on test scenes.
std::vector<Layer> layers_of_run(const LayersArguments& arguments) {
  const auto warn = [](std::string_view line) { fmt::print(stderr, "warning: {}\n", line); };
  const std::vector<std::string> all(kNetworkNames.begin(), kNetworkNames.end());
  const TrainedModel model = load_trained_model({arguments.run}, warn, all);
  Cascade& cascade = *model.cascade;
  cascade.set_training(true);
  cascade.set_skip(Skip::kNone);  // layers are timed as a whole
  Loader loader(open_dataset(model.config.data.path), {.split = Split::kTest,
                                                       .batch = arguments.batch,
                                                       .min_last = 1,
                                                       .shuffle = false,
                                                       .encode = model.config.model.encode});
  const std::optional<Batch> batch = loader.next();
  return capture(cascade.named_parameters(), [&] {
    const CascadeWanted wanted = wanted_outputs(model.config.loss, cascade.options());
    const CascadeOutput out =
        cascade.forward({.image = batch->input, .bsdf = batch->bsdf, .mask = batch->mask}, wanted);
    return compute_losses(model.config.loss, out, loss_targets(*batch)).total;
  });
}

void run_bench_layers(const LayersArguments& arguments) {
  if (arguments.net.empty() == arguments.run.empty()) {
    fail_usage("bench layers", "give either --net or --run");
  }
  const std::vector<Layer> layers =
      arguments.run.empty() ? layers_of_network(arguments) : layers_of_run(arguments);
  const Machine machine = measure_machine();
  fmt::print("{} threads, {}: {:.0f} GFLOP/s\n", num_threads(), machine.instruction_set, machine.gflops);
  fmt::print("| layer | shape | pass | way | ms | GFLOP/s | of peak | error | choice of |\n");
  fmt::print("|---|---|---|---|---:|---:|---:|---:|---|\n");
  int over = 0;
  std::map<Numerics, double> worst, total;
  Points points;
  for (const Layer& layer : layers) {
    double direct_error = 0.0;
    for (const ConvTiming& t : measure_conv(layer.data, arguments.repeats)) {
      if (t.outputs == 0) direct_error = t.error;
      std::vector<std::string> choices;
      for (const Numerics numerics : {Numerics::kStrict, Numerics::kBalanced, Numerics::kFast}) {
        if (kernels::choose_algorithm(layer.data.shape, t.pass, numerics) != t.outputs) continue;
        choices.emplace_back(to_string(numerics));
        total[numerics] += t.seconds;
        points[numerics].push_back({intensity(layer.data), t.gflops});
        // Relative to its bound; NaN counts as over it.
        const double share = t.error / bound(numerics, direct_error);
        if (!(share <= 1.0)) {
          ++over;
          choices.back() += " (over its bound)";
        }
        worst[numerics] = std::max(worst[numerics], share);
      }
      if (choices.empty()) continue;
      fmt::print("| {} | {} | {} | {} | {:.3f} | {:.0f} | {:.0f} % | {:.1e} | {} |\n", layer.name,
                 to_string(layer.data.shape), to_string(t.pass), algorithm_name(t.outputs), 1e3 * t.seconds,
                 t.gflops, 100.0 * t.gflops / machine.gflops, t.error, fmt::join(choices, ", "));
      std::fflush(stdout);
    }
  }
  for (const auto& [numerics, seconds] : total) {
    fmt::print("{}: {:.1f} ms in all, worst error {:.2f} of its bound\n", to_string(numerics), 1e3 * seconds,
               worst[numerics]);
  }
  if (!arguments.plot.empty()) write_file_atomically(arguments.plot, draw_roofline(points, machine));
  if (over > 0) fail("bench layers", "{} choices are over the bound of their numerics", over);
}

}  // namespace

void add_bench_layers(CLI::App& bench) {
  const auto arguments = std::make_shared<LayersArguments>();
  CLI::App* command =
      bench.add_subcommand("layers",
                           "Time every convolution of a network, or of all networks of a run, on what it "
                           "reads in a training step: for\n"
                           "each pass the algorithms that strict, balanced and fast numerics choose, and "
                           "their root-mean-square error\n"
                           "against float64. Fails where an error is over the bound of the numerics.");
  const std::vector<std::string> nets{"normal", "depth", "illumination", "sss", "reconstruction"};
  command->add_option("--net", arguments->net, "A network with fresh weights, on noise")
      ->check(CLI::IsMember(nets));
  command->add_option("--run", arguments->run, "A run folder: its weights, on its test scenes");
  command->add_option("--size", arguments->size, "Image size, with --net")->capture_default_str();
  command->add_option("--batch", arguments->batch, "Images")
      ->check(CLI::Range(2, 1024))
      ->capture_default_str();
  command->add_option("--width", arguments->width, "Channels of the first layer, with --net")
      ->capture_default_str();
  command->add_option("--repeats", arguments->repeats, "Turns of each algorithm")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option(
      "--plot", arguments->plot,
      "Write the rate over the arithmetic intensity, below the machine's roof, to this SVG file");
  command->callback([arguments] { run_bench_layers(*arguments); });
}

}  // namespace opaline::cli
