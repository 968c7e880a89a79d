// A stage's losses on a part of the images.
#include <catch2/catch.hpp>
#include <cmath>
#include <cstring>

#include "core/autograd.h"
#include "models/cascade.h"
#include "nn/pattern.h"
#include "train/losses.h"

namespace opaline {
namespace {

using Sites = std::shared_ptr<const ActiveSites>;

constexpr int64_t kSize = 32;

/// Pixels of images of 32 x 32 by a rule of (image, row, column).
template <class F>
Sites sites_where(int64_t n, const F& active) {
  std::vector<uint8_t> flags;
  for (int64_t i = 0; i < n * kSize * kSize; ++i) {
    flags.push_back(active(i / (kSize * kSize), i / kSize % kSize, i % kSize) ? 1 : 0);
  }
  return std::make_shared<const ActiveSites>(n, kSize, kSize, flags);
}

bool same_bits(const Tensor& a, const Tensor& b) {
  return a.numel() == b.numel() && std::memcmp(a.bytes(), b.bytes(), static_cast<size_t>(a.byte_size())) == 0;
}

struct StageStep {
  double loss;
  std::vector<Tensor> gradients;
};

StageStep stage_step(const Sites& sites, bool checkpoint = false) {
  const CascadeOptions options{.network = {.image_size = kSize, .width = 4}, .checkpoint = checkpoint};
  Cascade cascade(options);
  cascade.initialize(3);
  const auto pattern = [](Shape shape, uint32_t tag) {
    return test::pattern_tensor(std::move(shape), tag, 1.0, 0.0, DType::kFloat32);
  };
  const int64_t n = 2;
  CascadeInput input{.image = pattern({n, kSize, kSize, options.network.input_channels}, 1),
                     .bsdf = pattern({n, kSize, kSize, kBsdfChannels}, 2),
                     .sites = sites};
  Tensor mask({n, kSize, kSize, 1});
  for (int64_t i = 0; i < mask.numel(); ++i) {
    const bool inside = !sites || sites->site(i / (kSize * kSize), i / kSize % kSize, i % kSize) >= 0;
    mask.data<float>()[i] = inside && i % 3 != 0 ? 1.0F : 0.0F;
  }
  const LossTargets targets{.mask = mask,
                            .normal = pattern({n, kSize, kSize, 3}, 3),
                            .depth = pattern({n, kSize, kSize, 1}, 4),
                            .illumination = pattern({n, illumination_values(Variant::kRelease)}, 5),
                            .sss = pattern({n, sss_values(Variant::kRelease)}, 6),
                            .reconstruction = pattern({n, kSize, kSize, kBsdfChannels}, 7)};
  const LossOptions losses;
  const Losses result =
      compute_losses(losses, cascade.forward(input, wanted_outputs(losses, options)), targets);
  backward(result.total);
  StageStep step{result.total.item(), {}};
  for (const NamedTensor& parameter : cascade.named_parameters()) {
    step.gradients.push_back(parameter.tensor.grad());
  }
  return step;
}

TEST_CASE("a stage on active sites: full as without, checkpointed as without, empty without harm") {
  const Sites full = sites_where(2, [](int64_t, int64_t, int64_t) { return true; });
  const Sites some =
      sites_where(2, [](int64_t n, int64_t i, int64_t j) { return i < 16 || (n == 0 && j < 16); });
  const Sites none = sites_where(2, [](int64_t, int64_t, int64_t) { return false; });
  const auto check_equal = [](const StageStep& a, const StageStep& b) {
    CHECK(a.loss == b.loss);
    REQUIRE(a.gradients.size() == b.gradients.size());
    for (size_t i = 0; i < a.gradients.size(); ++i) {
      INFO("parameter " << i);
      CHECK(same_bits(a.gradients[i], b.gradients[i]));
    }
  };
  check_equal(stage_step(nullptr), stage_step(full));
  check_equal(stage_step(some), stage_step(some, true));
  const StageStep empty = stage_step(none);
  CHECK(std::isfinite(empty.loss));
  for (const Tensor& gradient : empty.gradients) {
    REQUIRE(gradient.defined());
    for (int64_t i = 0; i < gradient.numel(); ++i) REQUIRE(std::isfinite(gradient.at(i)));
  }
}

}  // namespace
}  // namespace opaline
