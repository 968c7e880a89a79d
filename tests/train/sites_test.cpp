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

constexpr int64_t kSize = 32;
constexpr int64_t kImages = 2;

/// A mask by a rule of (image, row, column).
template <class F>
Tensor mask_where(const F& inside) {
  Tensor mask({kImages, kSize, kSize, 1});
  for (int64_t i = 0; i < mask.numel(); ++i) {
    mask.data<float>()[i] = inside(i / (kSize * kSize), i / kSize % kSize, i % kSize) ? 1.0F : 0.0F;
  }
  return mask;
}

bool same_bits(const Tensor& a, const Tensor& b) {
  return a.numel() == b.numel() && std::memcmp(a.bytes(), b.bytes(), static_cast<size_t>(a.byte_size())) == 0;
}

struct StageStep {
  double loss;
  std::vector<Tensor> gradients;
};

StageStep stage_step(const Tensor& mask, Skip skip, bool checkpoint = false) {
  const CascadeOptions options{
      .network = {.image_size = kSize, .width = 4}, .checkpoint = checkpoint, .skip = skip};
  Cascade cascade(options);
  cascade.initialize(3);
  const int64_t n = kImages;
  const auto pattern = [](Shape shape, uint32_t tag) {
    return test::pattern_tensor(std::move(shape), tag, 1.0, 0.0, DType::kFloat32);
  };
  const CascadeInput input{.image = pattern({n, kSize, kSize, options.network.input_channels}, 1),
                           .bsdf = pattern({n, kSize, kSize, kBsdfChannels}, 2),
                           .mask = mask};
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
  // A pixel of every tile is all that the support needs.
  const Tensor full =
      mask_where([](int64_t, int64_t i, int64_t j) { return i % 15 == 1 || (i * j) % 3 == 1; });
  const Tensor some = mask_where([](int64_t n, int64_t i, int64_t j) { return i < 9 && (n == 0 || j > 20); });
  const Tensor none = mask_where([](int64_t, int64_t, int64_t) { return false; });
  const auto check_equal = [](const StageStep& a, const StageStep& b) {
    CHECK(a.loss == b.loss);
    REQUIRE(a.gradients.size() == b.gradients.size());
    for (size_t i = 0; i < a.gradients.size(); ++i) {
      INFO("parameter " << i);
      CHECK(same_bits(a.gradients[i], b.gradients[i]));
    }
  };
  check_equal(stage_step(full, Skip::kNone), stage_step(full, Skip::kSupport));
  check_equal(stage_step(some, Skip::kSupport), stage_step(some, Skip::kSupport, true));
  CHECK(stage_step(some, Skip::kSupport).loss != stage_step(some, Skip::kNone).loss);
  const StageStep empty = stage_step(none, Skip::kSupport);
  CHECK(std::isfinite(empty.loss));
  for (const Tensor& gradient : empty.gradients) {
    REQUIRE(gradient.defined());
    for (int64_t i = 0; i < gradient.numel(); ++i) REQUIRE(std::isfinite(gradient.at(i)));
  }
}

}  // namespace
}  // namespace opaline
