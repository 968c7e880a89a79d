#include "train/memory_estimate.h"

#include <fmt/format.h>

#include <algorithm>
#include <charconv>
#include <fstream>

#include "core/autograd.h"
#include "core/memory.h"
#include "core/numerics.h"
#include "train/stage.h"

namespace opaline {
namespace {

constexpr int64_t kProbe = 64;  // side of the images that are run
// The pool keeps freed blocks of sizes that nothing asks for at the moment: the share of a process's memory
// over its peak use that was measured in training is 1.2 to 1.4.
constexpr double kPoolOverhead = 1.35;

/// A batch of `n` black images, with everything that the losses compare with.
Batch probe_batch(const RunConfig& config, int64_t n) {
  const EncodeOptions& encode = config.model.encode;
  const auto zeros = [&](int64_t channels) { return Tensor::zeros({n, kProbe, kProbe, channels}); };
  return {.ids = std::vector<std::string>(static_cast<size_t>(n), "probe"),
          .input = zeros(input_channels(encode)),
          .normal = zeros(3),
          .depth = zeros(1),
          .mask = Tensor::full({n, kProbe, kProbe, 1}, 1.0),
          .illumination = Tensor::zeros({n, illumination_values(encode)}),
          .sss = Tensor::zeros({n, sss_values(encode)}),
          .bsdf = zeros(kBsdfChannels),
          .polarised = zeros(kBsdfChannels)};
}

int64_t byte_size(const Batch& batch) {
  int64_t bytes = 0;
  for (const Tensor* tensor : {&batch.input, &batch.normal, &batch.depth, &batch.mask, &batch.illumination,
                               &batch.sss, &batch.bsdf, &batch.polarised}) {
    bytes += tensor->byte_size();
  }
  return bytes;
}

/// Bytes that the pool's use grows by at most in a forward and backward pass of n images, which leaves
/// gradients.
int64_t probe_peak(Cascade& cascade, const RunConfig& config, int64_t n) {
  const Batch batch = probe_batch(config, n);
  const int64_t before = tensor_pool().bytes_in_use();
  tensor_pool().reset_peak();
  {
    const CascadeWanted wanted = wanted_outputs(config.loss, cascade.options());
    const CascadeOutput out =
        cascade.forward({.image = batch.input, .bsdf = batch.bsdf, .mask = batch.mask}, wanted);
    backward(compute_losses(config.loss, out, loss_targets(batch)).total);
  }
  return tensor_pool().peak_bytes() - before;
}

std::optional<int64_t> first_number(const std::string& text) {
  int64_t value = 0;
  const auto begin = std::find_if(text.begin(), text.end(), [](char c) { return c >= '0' && c <= '9'; });
  const char* const from = text.data() + (begin - text.begin());
  if (std::from_chars(from, text.data() + text.size(), value).ec != std::errc()) return std::nullopt;
  return value;
}

std::optional<int64_t> number_in(const char* path) {
  std::ifstream file(path);
  std::string line;
  if (!std::getline(file, line)) return std::nullopt;
  return first_number(line);
}

std::string gib(int64_t bytes) {
  return fmt::format("{:.2f} GiB", static_cast<double>(bytes) / (1 << 30));
}

}  // namespace

MemoryEstimate estimate_memory(const RunConfig& config, int64_t width, int64_t height) {
  // With choices of its own: the probe's shapes are none of the run's.
  const NumericsGuard numerics(config.train.numerics);
  MemoryEstimate estimate;
  const int number = config.stages[1].epochs > 0 ? 2 : 1;
  Stage stage(config, number);
  int64_t trained = 0;
  for (const NamedTensor& parameter : stage.adam().parameters()) trained += parameter.tensor.byte_size();
  for (const std::string& name : stage.cascade().network_names()) {
    for (const auto& [key, tensor] : stage.cascade().network(name).state_dict())
      estimate.parameters += tensor.byte_size();
  }
  estimate.parameters += 3 * trained;  // gradients and two moments

  // With gradients there from a first pass, they do not count as growth. Two images are the fewest that batch
  // statistics can be of.
  probe_peak(stage.cascade(), config, 2);
  const auto two = static_cast<double>(probe_peak(stage.cascade(), config, 2));
  const auto four = static_cast<double>(probe_peak(stage.cascade(), config, 4));
  stage.cascade().zero_grad();
  const double per_probe = std::max(0.0, (four - two) / 2.0);
  const double once = std::max(0.0, two - 2.0 * per_probe);
  const double pixels = static_cast<double>(width * height);
  const double probes = pixels / static_cast<double>(kProbe * kProbe);
  const auto images = static_cast<double>(config.train.micro_batch);
  estimate.activations = static_cast<int64_t>(kPoolOverhead * (once + images * per_probe * probes));
  tensor_pool().release_cached();

  // Read ahead, one being made by each thread, and the one that is trained on.
  const int64_t batches = config.data.prefetch + config.data.threads + 1;
  const double batch_bytes = static_cast<double>(byte_size(probe_batch(config, 1))) * probes * images;
  estimate.data =
      static_cast<int64_t>(static_cast<double>(batches) * batch_bytes) + (config.data.cache_mib << 20);
  return estimate;
}

std::optional<int64_t> available_memory() {
  std::optional<int64_t> least;
  const auto take = [&](std::optional<int64_t> bytes) {
    if (bytes) least = least ? std::min(*least, *bytes) : *bytes;
  };
  std::ifstream file("/proc/meminfo");
  for (std::string line; std::getline(file, line);) {
    if (!line.starts_with("MemAvailable:")) continue;
    const auto kib = first_number(line);
    if (kib) take(*kib << 10);
  }
  const auto limit = number_in("/sys/fs/cgroup/memory.max");  // "max" where there is none
  const auto used = number_in("/sys/fs/cgroup/memory.current");
  if (limit && used) take(std::max<int64_t>(0, *limit - *used));
  return least;
}

std::string describe(const MemoryEstimate& estimate, std::optional<int64_t> available) {
  std::string text = fmt::format(
      "memory: about {} (weights, gradients and moments {}, a micro-batch {}, data {})",
      gib(estimate.total()), gib(estimate.parameters), gib(estimate.activations), gib(estimate.data));
  if (!available) return text;
  text += fmt::format("; {} is free", gib(*available));
  if (estimate.total() > *available) {
    text = "warning: " + text +
           ". It will not suffice: set train.activation_checkpointing, or lower train.micro_batch, "
           "data.cache_mib, data.prefetch or model.width";
  }
  return text;
}

}  // namespace opaline
