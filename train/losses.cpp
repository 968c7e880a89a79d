#include "train/losses.h"

#include "core/error.h"
#include "core/ops/arithmetic.h"
#include "core/ops/loss.h"
#include "core/ops/sites.h"

namespace opaline {
namespace {

Tensor image_loss(LossKind kind, const Tensor& x, const Tensor& target, const Tensor& mask) {
  switch (kind) {
    case LossKind::kL1:
      return masked_l1_loss(x, target, mask);
    case LossKind::kL2:
      return masked_mse_loss(x, target, mask);
    case LossKind::kCosine:
      return cosine_loss(x, target, mask);
  }
  fail("loss", "unknown kind {}", static_cast<int>(kind));
}

Tensor vector_loss(LossKind kind, const Tensor& x, const Tensor& target) {
  return kind == LossKind::kL1 ? l1_loss(x, target) : mse_loss(x, target);
}

}  // namespace

std::string_view to_string(LossKind kind) {
  switch (kind) {
    case LossKind::kL1:
      return "l1";
    case LossKind::kL2:
      return "l2";
    case LossKind::kCosine:
      return "cosine";
  }
  return "";
}

std::optional<LossKind> parse_loss_kind(std::string_view text) {
  for (const LossKind kind : {LossKind::kL1, LossKind::kL2, LossKind::kCosine}) {
    if (text == to_string(kind)) return kind;
  }
  return std::nullopt;
}

const LossTerm& loss_term(const LossOptions& options, std::string_view name) {
  if (name == "normal") return options.normal;
  if (name == "depth") return options.depth;
  if (name == "illumination") return options.illumination;
  if (name == "sss") return options.sss;
  if (name == "reconstruction") return options.reconstruction;
  fail("loss", "there is no term \"{}\"", name);
}

CascadeWanted wanted_outputs(const LossOptions& options, const CascadeOptions& cascade) {
  const bool second = cascade.stage == 2;
  return {.normal = options.normal.weight > 0.0,
          .depth = options.depth.weight > 0.0,
          .illumination = options.illumination.weight > 0.0,
          .sss = second && options.sss.weight > 0.0,
          .reconstruction = second && cascade.reconstruction && options.reconstruction.weight > 0.0};
}

Losses compute_losses(const LossOptions& options, const CascadeOutput& output, const LossTargets& targets) {
  Losses losses;
  const auto add_term = [&](std::string_view name, Tensor value) {
    const Tensor weighted = affine(value, loss_term(options, name).weight);
    losses.total = losses.total.defined() ? add(losses.total, weighted) : weighted;
    losses.terms.push_back({name, std::move(value)});
  };
  const auto image = [&](std::string_view name, const Tensor& x, const Tensor& target) {
    const LossTerm& term = loss_term(options, name);
    if (!(term.weight > 0.0) || !x.defined()) return;
    const auto selected = [&x](const Tensor& t) { return x.sites() ? select_sites(t, x.sites()) : t; };
    add_term(name, image_loss(term.kind, x, selected(target), selected(targets.mask)));
  };
  const auto vector = [&](std::string_view name, const Tensor& x, const Tensor& target) {
    const LossTerm& term = loss_term(options, name);
    if (term.weight > 0.0 && x.defined()) add_term(name, vector_loss(term.kind, x, target));
  };
  image("normal", output.normal, targets.normal);
  image("depth", output.depth, targets.depth);
  vector("illumination", output.illumination, targets.illumination);
  vector("sss", output.sss, targets.sss);
  image("reconstruction", output.reconstruction, targets.reconstruction);
  if (!losses.total.defined()) fail("loss", "no term has a weight and an output: nothing to train");
  return losses;
}

}  // namespace opaline
