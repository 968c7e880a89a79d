// `opaline bench step`: time, work and memory of one training step or forward pass.
#include <algorithm>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <numeric>
#include <string>
#include <vector>

#include "cli/bench.h"
#include "cli/numerics_option.h"
#include "core/autograd.h"
#include "core/clock.h"
#include "core/error.h"
#include "core/memory.h"
#include "core/numerics.h"
#include "core/random.h"
#include "data/png.h"
#include "models/cascade.h"
#include "train/graph.h"
#include "train/losses.h"

namespace opaline::cli {
namespace {

struct BenchArguments {
  std::string net;
  int64_t size = 256;
  int64_t batch = 1;
  int64_t width = 64;
  int64_t repeats = 3;
  std::string mask;  // a PNG file or a share of the pixels; empty: all of them
  Numerics numerics = Numerics::kBalanced;
  bool forward_only = false;
  bool json = false;
};

Tensor random_tensor(Shape shape, uint32_t sample, double low = -1.0, double high = 1.0) {
  Tensor tensor(std::move(shape));
  Random random(1, Purpose::kTest, 0, sample);
  for (float& value : tensor.values<float>()) value = static_cast<float>(random.uniform(low, high));
  return tensor;
}

/// The object's pixels, batch x size x size x 1: those of a PNG that have its largest value, nearest pixels
/// where it is of another size; or a disc in the middle that covers the share.
Tensor make_mask(const BenchArguments& arguments) {
  const int64_t size = arguments.size;
  const int64_t pixels = size * size;
  std::vector<float> one(static_cast<size_t>(pixels), 1.0F);
  if (std::filesystem::is_regular_file(arguments.mask)) {
    const PngImage image = read_png(arguments.mask);
    const int largest = (1 << image.bits) - 1;
    for (int64_t i = 0; i < pixels; ++i) {
      const auto x = static_cast<int>(i % size * image.width / size);
      const auto y = static_cast<int>(i / size * image.height / size);
      one[static_cast<size_t>(i)] = image.samples[image.at(x, y, 0)] == largest ? 1.0F : 0.0F;
    }
  } else if (!arguments.mask.empty()) {
    double share = 0.0;
    const char* const end = arguments.mask.data() + arguments.mask.size();
    const auto [last, error] = std::from_chars(arguments.mask.data(), end, share);
    if (error != std::errc() || last != end || !(share >= 0.0 && share <= 1.0)) {
      fail_usage("bench step", "--mask {} is neither a PNG file nor a coverage from 0 to 1", arguments.mask);
    }
    // By distance from the middle, the nearest first: exactly the share, also where the disc meets the
    // border.
    std::vector<int64_t> order(one.size());
    std::iota(order.begin(), order.end(), int64_t{0});
    const auto distance = [&](int64_t i) {
      const int64_t dx = 2 * (i % size) + 1 - size;
      const int64_t dy = 2 * (i / size) + 1 - size;
      return dx * dx + dy * dy;
    };
    std::stable_sort(order.begin(), order.end(),
                     [&](int64_t a, int64_t b) { return distance(a) < distance(b); });
    const auto inside = static_cast<size_t>(std::llround(share * static_cast<double>(pixels)));
    for (size_t k = inside; k < order.size(); ++k) one[static_cast<size_t>(order[k])] = 0.0F;
  }
  Tensor mask({arguments.batch, size, size, 1});
  const std::span<float> values = mask.values<float>();
  for (size_t i = 0; i < values.size(); ++i) values[i] = one[i % one.size()];
  return mask;
}

/// What is timed: a forward pass that gives a scalar or a result, and how to go backward from it.
class Step {
 public:
  virtual ~Step() = default;
  virtual Tensor forward() = 0;
  virtual void go_backward(const Tensor& result) { backward(result); }
  virtual void zero_grad() = 0;
  virtual void set_training(bool on) = 0;
  virtual std::vector<NamedTensor> parameters() const = 0;
};

class NetworkStep : public Step {
 public:
  explicit NetworkStep(const BenchArguments& arguments)
      : network_(make_network(arguments.net, {.image_size = arguments.size, .width = arguments.width})) {
    initialize_network(*network_, arguments.net, 1);
    const NetworkOptions released;
    const int64_t n = released.input_channels;
    const int64_t b = arguments.batch;
    const int64_t s = arguments.size;
    if (arguments.net == "illumination_decoder") {
      input_ = random_tensor({b, illumination_values(released.variant)}, 0);
    } else if (arguments.net == "sss") {
      input_ = random_tensor({b, s, s, 5 + n}, 0);
    } else if (arguments.net == "reconstruction") {
      input_ = random_tensor({b, s, s, kBsdfChannels + sss_values(released.variant)}, 0);
    } else {
      input_ = random_tensor({b, s, s, n}, 0);
    }
  }
  Tensor forward() override { return network_->forward(input_); }
  void go_backward(const Tensor& result) override {
    if (!cotangent_.defined()) cotangent_ = random_tensor(result.shape(), 1);
    backward(result, cotangent_);
  }
  void zero_grad() override { network_->zero_grad(); }
  void set_training(bool on) override { network_->set_training(on); }
  std::vector<NamedTensor> parameters() const override { return network_->named_parameters(); }

 private:
  std::unique_ptr<Network> network_;
  Tensor input_, cotangent_;
};

/// A stage with its losses, or for "cascade" what prediction computes: all networks but the reconstruction.
class StageStep : public Step {
 public:
  explicit StageStep(const BenchArguments& arguments)
      : losses_(arguments.net != "cascade"),
        cascade_({.network = {.image_size = arguments.size, .width = arguments.width},
                  .stage = arguments.net == "stage1" ? 1 : 2,
                  .reconstruction = arguments.net == "stage2"}) {
    cascade_.initialize(1);
    const Variant variant = cascade_.options().network.variant;
    const int64_t b = arguments.batch;
    const int64_t s = arguments.size;
    input_.image = random_tensor({b, s, s, cascade_.options().network.input_channels}, 0);
    input_.bsdf = random_tensor({b, s, s, kBsdfChannels}, 1);
    targets_.mask = make_mask(arguments);
    targets_.normal = random_tensor({b, s, s, 3}, 2);
    targets_.depth = random_tensor({b, s, s, 1}, 3);
    targets_.illumination = random_tensor({b, illumination_values(variant)}, 4);
    targets_.sss = random_tensor({b, sss_values(variant)}, 5);
    targets_.reconstruction = random_tensor({b, s, s, kBsdfChannels}, 6);
  }
  Tensor forward() override {
    if (!losses_) return cascade_.forward(input_).sss;
    const LossOptions losses;
    const CascadeWanted wanted = wanted_outputs(losses, cascade_.options());
    return compute_losses(losses, cascade_.forward(input_, wanted), targets_).total;
  }
  void zero_grad() override { cascade_.zero_grad(); }
  void set_training(bool on) override { cascade_.set_training(on); }
  std::vector<NamedTensor> parameters() const override { return cascade_.named_parameters(); }

 private:
  bool losses_;
  Cascade cascade_;
  CascadeInput input_;
  LossTargets targets_;
};

void run_bench_step(const BenchArguments& arguments) {
  const bool stage = arguments.net == "stage1" || arguments.net == "stage2" || arguments.net == "cascade";
  if (arguments.net == "cascade" && !arguments.forward_only) {
    fail_usage("bench step", "cascade is what prediction computes: it needs --forward");
  }
  std::unique_ptr<Step> step;
  if (stage) {
    step = std::make_unique<StageStep>(arguments);
  } else {
    make_mask(arguments);  // a bad one is told here too
    step = std::make_unique<NetworkStep>(arguments);
  }

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
        arguments.net, arguments.forward_only ? "forward" : "forward and backward", arguments.batch,
        arguments.size, arguments.size, middle, gflops, 1e-9 * static_cast<double>(macs),
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
  std::vector<std::string> nets(kNetworkNames.begin(), kNetworkNames.end());
  nets.insert(nets.end(), {"stage1", "stage2", "cascade"});
  command->add_option("--net", arguments->net, fmt::format("One of {}", fmt::join(nets, ", ")))
      ->required()
      ->check(CLI::IsMember(nets));
  command->add_option("--size", arguments->size, "Image size")->capture_default_str();
  command->add_option("--batch", arguments->batch, "Images")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--width", arguments->width, "Channels of the first layer")->capture_default_str();
  command->add_option(
      "--mask", arguments->mask,
      "The object's pixels: a PNG, or a coverage such as 0.3 (a disc). The networks compute all pixels "
      "whatever it is; of a stage, the losses are over it");
  command->add_option("--repeats", arguments->repeats, "Timed repetitions after one warm-up")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  add_numerics_option(*command, arguments->numerics);
  command->add_flag("--forward", arguments->forward_only, "The forward pass alone, in evaluation mode");
  command->add_flag("--json", arguments->json, "Print one JSON object");
  command->callback([arguments] { run_bench_step(*arguments); });
}

}  // namespace opaline::cli
