// `opaline forward`: one network on one tensor, with gradients on request. This is how weights and results
// are compared with other implementations.
#include <filesystem>
#include <string>

#include "cli/commands.h"
#include "cli/network_input.h"
#include "cli/numerics_option.h"
#include "core/autograd.h"
#include "core/safetensors.h"
#include "models/network.h"
#include "train/config.h"

namespace opaline::cli {
namespace {

struct ForwardArguments {
  std::string network;
  std::filesystem::path weights, input, output;
  std::string mode = "eval";
  std::string dtype = "float32";
  std::filesystem::path config;
  std::string variant = "release";
  NetworkOptions options;  // where there is no config
  Numerics numerics = Numerics::kBalanced;
  bool grad = false;
  bool force = false;
};

Tensor gradient_or_zeros(const Tensor& leaf) {
  return leaf.grad().defined() ? leaf.grad() : Tensor::zeros(leaf.shape(), leaf.dtype());
}

// The config's sizes, or the released ones with what the command line says.
NetworkOptions network_options(const ForwardArguments& arguments) {
  NetworkOptions options = arguments.options;
  options.variant = arguments.variant == "paper" ? Variant::kPaper : Variant::kRelease;
  if (!arguments.config.empty()) options = cascade_options(load_run_config(arguments.config), 2).network;
  options.dtype = arguments.dtype == "float64" ? DType::kFloat64 : DType::kFloat32;
  return options;
}

void run_forward(const ForwardArguments& arguments) {
  const NetworkOptions options = network_options(arguments);
  const bool training = arguments.mode == "train";
  const std::string input_file = arguments.input.string();

  const std::unique_ptr<Network> network = make_network(arguments.network, options);
  network->load_state_dict(load_safetensors(arguments.weights).tensors,
                           {.allow_non_finite = arguments.force, .source = arguments.weights.string()});
  network->set_training(training);
  network->set_requires_grad(arguments.grad);
  const NumericsGuard numerics(arguments.numerics);

  const TensorMap input = load_safetensors(arguments.input).tensors;
  Tensor x = read_input(input, options.dtype, input_file);
  x.set_requires_grad(arguments.grad);
  const Tensor y = network->forward(x);

  TensorMap result;
  result["y"] = outward(y.detach());
  if (arguments.grad) {
    backward(y, read_cotangent(input, y, input_file));
    result["grad.x"] = outward(gradient_or_zeros(x));
    for (const NamedTensor& parameter : network->named_parameters()) {
      result["grad." + parameter.name] = gradient_or_zeros(parameter.tensor);
    }
  }
  if (training) {
    for (const NamedTensor& buffer : network->named_buffers()) {
      result["buffer." + buffer.name] = buffer.tensor;
    }
  }
  save_safetensors(arguments.output, result);
}

}  // namespace

void add_forward(CLI::App& app, Outcome&) {
  const auto arguments = std::make_shared<ForwardArguments>();
  CLI::App* command = app.add_subcommand(
      "forward",
      "Run one network on tensor 'x' (N x C x H x W; N x K for the decoder) and write 'y'.\n"
      "Sizes are the released ones unless told otherwise.");
  command->add_option("network", arguments->network, fmt::format("One of {}", fmt::join(kNetworkNames, ", ")))
      ->required()
      ->check(CLI::IsMember(std::vector<std::string>(kNetworkNames.begin(), kNetworkNames.end())));
  command->add_option("--weights", arguments->weights, "Weights, safetensors with PyTorch's names")
      ->required();
  command->add_option("--input", arguments->input, "safetensors with 'x' and, for --grad, 'cotangent'")
      ->required();
  command->add_option("--output", arguments->output, "safetensors to write")->required();
  command
      ->add_option("--mode", arguments->mode,
                   "train (batch statistics; writes 'buffer.<name>') or eval (running statistics)")
      ->check(CLI::IsMember({"train", "eval"}))
      ->capture_default_str();
  command->add_flag("--grad", arguments->grad,
                    "Also the gradient of sum(y * cotangent), as 'grad.x' and 'grad.<parameter>'");
  command->add_option("--dtype", arguments->dtype, "Type of weights, arithmetic and results")
      ->check(CLI::IsMember({"float32", "float64"}))
      ->capture_default_str();
  add_numerics_option(*command, arguments->numerics);
  CLI::Option* config = command->add_option("--config", arguments->config,
                                            "Training config that gives variant, sizes and channels");
  const auto add_size = [&](const std::string& name, auto& value, const std::string& text) {
    return command->add_option(name, value, text)->capture_default_str()->excludes(config);
  };
  add_size("--variant", arguments->variant, "Channel counts")->check(CLI::IsMember({"paper", "release"}));
  add_size("--size", arguments->options.image_size, "Build size");
  add_size("--width", arguments->options.width, "Channels of the first layer");
  add_size("--channels", arguments->options.input_channels, "Channels of the network input");
  command->add_flag("--force", arguments->force, "Take weights that hold NaN or infinities");
  command->callback([arguments] { run_forward(*arguments); });
}

}  // namespace opaline::cli
