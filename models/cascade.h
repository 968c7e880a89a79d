// The two-stage cascade. Stage 1 estimates normal, depth and illumination from the image; stage 2 adds the
// subsurface scattering (SSS) parameters from all of these, and in training the reconstruction of the
// polarised images from the pure-BSDF ones and the parameters.
#pragma once

#include <cstdint>
#include <map>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "core/tensor.h"
#include "models/network.h"

namespace opaline {

/// Where the image networks compute, all but the illumination's, whose cue lies around the object:
/// everywhere, or on the tiles of 16 x 16 pixels that touch the object's mask alone (core/active_sites.h).
enum class Skip { kNone, kSupport };
/// "none", "support".
std::string_view to_string(Skip skip);
std::optional<Skip> parse_skip(std::string_view text);

struct CascadeOptions {
  NetworkOptions network = {};
  int stage = 2;               ///< 1: normal, depth, illumination only
  bool reconstruction = true;  ///< have the reconstruction network too (stage 2)
  bool checkpoint = false;  ///< in the backward pass, compute each network once more instead of keeping all
  Skip skip = Skip::kNone;
  int64_t dilation = 0;  ///< tiles around the mask's that are computed too
  /// The illumination network sees the image averaged over squares of so many pixels a side; its light of
  /// nine coefficients a colour is smooth. What is left must be an image that networks take.
  int64_t illumination_downscale = 1;

  /// The dilation of the support that is computed; nothing where everything is.
  std::optional<int64_t> support() const {
    return skip == Skip::kSupport ? std::optional(dilation) : std::nullopt;
  }
};

/// Which results to compute; those that they need are computed (and given) too.
struct CascadeWanted {
  bool normal = true;
  bool depth = true;
  bool illumination = true;
  bool sss = true;              ///< needs normal, depth and illumination
  bool reconstruction = false;  ///< needs sss, and CascadeInput::bsdf
};

/// Where something is skipped bsdf and mask may be whole, or of the support's sites already.
struct CascadeInput {
  Tensor image;  ///< N x H x W x input channels
  Tensor bsdf;   ///< N x H x W x 12, the four pure-BSDF images; may be undefined without reconstruction
  Tensor mask;   ///< N x H x W x 1, nonzero on the object; may be undefined where nothing is skipped
};

/// What was not computed is undefined. Where something is skipped images are of the sites that were computed.
struct CascadeOutput {
  Tensor normal;            ///< N x H x W x 3, not of unit length
  Tensor depth;             ///< N x H x W x 1
  Tensor illumination;      ///< N x 27, channel-major SH; 28 in the paper variant, flash last
  Tensor illumination_map;  ///< N x H x W x 1
  Tensor sss;               ///< N x 7: g, sigma_t (3), albedo (3), each in [-1, 1]; release: 8, flash last
  Tensor reconstruction;    ///< N x H x W x 12
};

/// The same with whole images, zeros where nothing was computed.
CascadeOutput whole(const CascadeOutput& output);

class Cascade {
 public:
  explicit Cascade(const CascadeOptions& options);

  /// Computes what is wanted. Throws Error where a wanted network or input is not there.
  CascadeOutput forward(const CascadeInput& input, const CascadeWanted& wanted);
  /// All that the networks of this stage give.
  CascadeOutput forward(const CascadeInput& input);

  const CascadeOptions& options() const { return options_; }
  /// Names of the networks there are, in the order of kNetworkNames.
  std::vector<std::string> network_names() const;
  bool has(std::string_view name) const;
  /// Throws Error where there is none of that name in this stage.
  Network& network(std::string_view name);
  const Network& network(std::string_view name) const;

  /// Draws all weights (initialize_network).
  void initialize(uint64_t seed);
  /// Parameters of all networks, as "<network>.<parameter>".
  std::vector<NamedTensor> named_parameters() const;
  void set_training(bool on);
  /// Weights are the same either way.
  void set_skip(Skip skip) { options_.skip = skip; }
  void zero_grad();

 private:
  CascadeOptions options_;
  std::map<std::string, std::unique_ptr<Network>, std::less<>> networks_;
};

}  // namespace opaline
