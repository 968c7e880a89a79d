#include "models/network.h"

#include <algorithm>
#include <string>
#include <vector>

#include "core/ops/sites.h"
#include "models/illumination.h"
#include "models/sss.h"
#include "models/unet.h"

namespace opaline {
namespace {

// Room for the parameters of one network in the numbering of initial weights.
constexpr uint32_t kInitStride = 4096;
constexpr int64_t kNormalChannels = 3;
constexpr int64_t kDepthChannels = 1;
constexpr int64_t kMapChannels = 1;

void check_options(std::string_view name, const NetworkOptions& options) {
  if (options.image_size < 32 || options.image_size % 16 != 0) {
    fail_usage(name, "image_size {} must be at least 32 and divisible by 16", options.image_size);
  }
  if (options.width < 4 || options.width % 4 != 0) {
    fail_usage(name, "width {} must be a positive multiple of 4", options.width);
  }
  if (options.input_channels < 1) fail_usage(name, "needs input channels, got {}", options.input_channels);
}

size_t network_index(std::string_view name) {
  const auto found = std::ranges::find(kNetworkNames, name);
  if (found == kNetworkNames.end()) {
    fail_usage("network", "no network '{}'; there are {}", name, fmt::join(kNetworkNames, ", "));
  }
  return static_cast<size_t>(found - kNetworkNames.begin());
}

}  // namespace

int64_t illumination_values(Variant variant) {
  return variant == Variant::kPaper ? 28 : 27;
}

int64_t sss_values(Variant variant) {
  return variant == Variant::kPaper ? 7 : 8;
}

void check_image_input(std::string_view network, std::span<const Tensor> parts, int64_t channels) {
  int64_t sum = 0;
  std::vector<std::string> shapes;
  bool images = !parts.empty();
  for (const Tensor& x : parts) {
    images = images && (x.dim() == 4 || x.sites());
    if (x.dim() > 0) sum += x.size(-1);
    shapes.push_back(to_string(x.shape()));
  }
  if (!images || sum != channels) {
    fail(network, "input is {}, expected N x H x W x {}", fmt::join(shapes, " and "), channels);
  }
  const ImageSize size = image_size(network, parts.front());
  for (const int64_t side : {size.h, size.w}) {
    if (side < 32 || side % 16 != 0) {
      fail(network, "images are {} x {}: both sides must be at least 32 and divisible by 16", size.h, size.w);
    }
  }
}

std::unique_ptr<Network> make_network(std::string_view name, const NetworkOptions& options) {
  network_index(name);
  check_options(name, options);
  const auto unet = [&](int64_t in, int64_t out) {
    return std::make_unique<TransUnet>(TransUnetConfig{
        .name = std::string(name), .in = in, .out = out, .width = options.width, .dtype = options.dtype});
  };
  const int64_t image_channels = options.input_channels;
  if (name == "normal") return unet(image_channels, kNormalChannels);
  if (name == "depth") return unet(image_channels, kDepthChannels);
  if (name == "reconstruction") return unet(kBsdfChannels + sss_values(options.variant), kBsdfChannels);
  if (name == "illumination") {
    return std::make_unique<IlluminationEncoder>(
        IlluminationEncoderConfig{.in = image_channels,
                                  .out = illumination_values(options.variant),
                                  .image_size = options.image_size,
                                  .width = options.width,
                                  .dtype = options.dtype});
  }
  if (name == "illumination_decoder") {
    return std::make_unique<IlluminationDecoder>(
        IlluminationDecoderConfig{.in = illumination_values(options.variant),
                                  .image_size = options.image_size,
                                  .width = options.width,
                                  .dtype = options.dtype});
  }
  return std::make_unique<SssNetwork>(
      SssConfig{.in = kMapChannels + kNormalChannels + kDepthChannels + image_channels,
                .out = sss_values(options.variant),
                .image_size = options.image_size,
                .width = options.width,
                .dtype = options.dtype});
}

void initialize_network(Network& network, std::string_view name, uint64_t seed) {
  initialize(network, seed, static_cast<uint32_t>(network_index(name)) * kInitStride);
}

}  // namespace opaline
