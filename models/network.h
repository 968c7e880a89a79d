// The six networks by name, and what they share.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <span>
#include <string_view>

#include "core/tensor.h"
#include "nn/module.h"

namespace opaline {

/// The paper's definition or that of the released implementation: they differ in channel counts.
enum class Variant { kPaper, kRelease };

/// Names of the networks, in the order that seeds their weights.
inline constexpr std::array<std::string_view, 6> kNetworkNames = {
    "normal", "depth", "illumination", "illumination_decoder", "sss", "reconstruction"};

struct NetworkOptions {
  Variant variant = Variant::kRelease;
  int64_t input_channels = 21;  ///< of the network input: 21 in the release, 19 in the paper
  int64_t image_size = 256;     ///< build size S: what the Linear layers and the decoder are made for
  int64_t width = 64;           ///< channels of the first layer; a multiple of 4
  DType dtype = DType::kFloat32;
};

/// Sizes that follow from the variant.
int64_t illumination_values(Variant variant);  ///< 28: 27 SH and flash; release 27
int64_t sss_values(Variant variant);           ///< 7: g, sigma_t (3), albedo (3); release 8: flash last
inline constexpr int64_t kBsdfChannels = 12;   ///< four polariser images of three channels

/// A network from one tensor to one tensor.
class Network : public Module {
 public:
  /// Images are N x H x W x C, H and W divisible by 16 and at least 32; vectors are N x K. All but the
  /// illumination networks take the active sites of images too (core/active_sites.h) and give theirs.
  Tensor forward(const Tensor& x) { return run(std::span(&x, 1)); }
  /// Of images joined along their channels: gradients are computed of those parts that want one.
  Tensor forward(std::span<const Tensor> parts) { return run(parts); }

 private:
  virtual Tensor run(std::span<const Tensor> parts) = 0;
};

/// Throws Error, naming the network, unless these are such images, or sites of one, of `channels` channels in
/// all.
void check_image_input(std::string_view network, std::span<const Tensor> parts, int64_t channels);

/// Makes a network with zero or constant weights; initialize_network() draws them. Throws UsageError on an
/// unknown name and on sizes that the network cannot have.
///   normal, depth          N x H x W x n -> N x H x W x 3, N x H x W x 1
///   illumination           N x H x W x n -> N x 27 (28)
///   illumination_decoder   N x 27 (28) -> N x S' x S' x 1, S' the power of two at or over S, at most 256
///   sss                    N x H x W x (5 + n) -> N x 8 (7)
///   reconstruction         N x H x W x (12 + 8 (7)) -> N x H x W x 12
std::unique_ptr<Network> make_network(std::string_view name, const NetworkOptions& options = {});

/// The recipe's initial weights; a network's do not depend on which other networks there are.
void initialize_network(Network& network, std::string_view name, uint64_t seed);

}  // namespace opaline
