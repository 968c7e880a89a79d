// The training loss: a weighted sum of one term an output.
#pragma once

#include <array>
#include <optional>
#include <string_view>
#include <vector>

#include "models/cascade.h"

namespace opaline {

enum class LossKind { kL1, kL2, kCosine };

/// "l1", "l2", "cosine".
std::string_view to_string(LossKind kind);
std::optional<LossKind> parse_loss_kind(std::string_view text);

struct LossTerm {
  double weight = 1.0;  ///< 0: the term is not computed, nor is a network that only it needs
  LossKind kind = LossKind::kL1;
};

/// Defaults: the release's weights. L1 and L2 of images are masked; cosine is for normals alone.
struct LossOptions {
  LossTerm normal{.weight = 100.0, .kind = LossKind::kL1};
  LossTerm depth{.weight = 1.0, .kind = LossKind::kL1};
  LossTerm illumination{.weight = 0.1, .kind = LossKind::kL2};
  LossTerm sss{.weight = 1.0, .kind = LossKind::kL2};
  LossTerm reconstruction{.weight = 1.0, .kind = LossKind::kL1};
};

/// Names of the terms, in the order of LossOptions.
inline constexpr std::array<std::string_view, 5> kLossNames = {"normal", "depth", "illumination", "sss",
                                                               "reconstruction"};
const LossTerm& loss_term(const LossOptions& options, std::string_view name);

/// What the outputs are compared with; shapes as in CascadeOutput. A target whose term is not computed may be
/// undefined.
struct LossTargets {
  Tensor mask;  ///< N x H x W x 1
  Tensor normal;
  Tensor depth;
  Tensor illumination;
  Tensor sss;
  Tensor reconstruction;
};

struct LossValue {
  std::string_view name;
  Tensor value;  ///< the unweighted term, a scalar with history
};

struct Losses {
  Tensor total;                  ///< sum of weight * term, a scalar with history
  std::vector<LossValue> terms;  ///< those computed
};

/// The outputs that the losses of a stage need: stage 1 has normal, depth and illumination.
CascadeWanted wanted_outputs(const LossOptions& options, const CascadeOptions& cascade);

/// All terms with a weight whose output is there. Throws Error where nothing is left.
Losses compute_losses(const LossOptions& options, const CascadeOutput& output, const LossTargets& targets);

}  // namespace opaline
