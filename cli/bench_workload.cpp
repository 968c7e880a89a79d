#include "cli/bench_workload.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <filesystem>
#include <numeric>
#include <span>

#include "core/autograd.h"
#include "core/error.h"
#include "core/ops/sites.h"
#include "core/random.h"
#include "data/png.h"
#include "models/cascade.h"
#include "train/losses.h"

namespace opaline::cli {
namespace {

template <class Draw>
Tensor noise(Shape shape, uint32_t sample, const Draw& draw) {
  Tensor tensor(std::move(shape));
  Random random(1, Purpose::kTest, 0, sample);
  for (float& value : tensor.values<float>()) value = static_cast<float>(draw(random));
  return tensor;
}

/// The object's pixels, batch x size x size x 1: those of a PNG that have its largest value, nearest pixels
/// where it is of another size; or a disc in the middle that covers the share.
Tensor make_mask(const Workload& workload) {
  const int64_t size = workload.size;
  const int64_t pixels = size * size;
  std::vector<float> one(static_cast<size_t>(pixels), 1.0F);
  if (std::filesystem::is_regular_file(workload.mask)) {
    const PngImage image = read_png(workload.mask);
    const int largest = (1 << image.bits) - 1;
    for (int64_t i = 0; i < pixels; ++i) {
      const auto x = static_cast<int>(i % size * image.width / size);
      const auto y = static_cast<int>(i / size * image.height / size);
      one[static_cast<size_t>(i)] = image.samples[image.at(x, y, 0)] == largest ? 1.0F : 0.0F;
    }
  } else if (!workload.mask.empty()) {
    double share = 0.0;
    const char* const end = workload.mask.data() + workload.mask.size();
    const auto [last, error] = std::from_chars(workload.mask.data(), end, share);
    if (error != std::errc() || last != end || !(share >= 0.0 && share <= 1.0)) {
      fail_usage("bench", "--mask {} is neither a PNG file nor a coverage from 0 to 1", workload.mask);
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
  Tensor mask({workload.batch, size, size, 1});
  const std::span<float> values = mask.values<float>();
  for (size_t i = 0; i < values.size(); ++i) values[i] = one[i % one.size()];
  return mask;
}

double share_of(const std::shared_ptr<const ActiveSites>& sites) {
  if (!sites) return 1.0;
  return static_cast<double>(sites->count()) / static_cast<double>(sites->n() * sites->h() * sites->w());
}

class NetworkStep : public Step {
 public:
  explicit NetworkStep(const Workload& workload)
      : network_(make_network(workload.net, {.image_size = workload.size, .width = workload.width})),
        input_(random_uniform(input_shape(workload.net, workload.batch, workload.size), 0)) {
    initialize_network(*network_, workload.net, 1);
    const Tensor mask = make_mask(workload);
    if (workload.skip && input_.dim() == 4 && workload.net != "illumination") {
      input_ = select_sites(input_, support_of(mask));
    }
  }
  Tensor forward() override { return network_->forward(input_); }
  void go_backward(const Tensor& result) override {
    if (!cotangent_.defined()) cotangent_ = random_uniform(result.shape(), 1);
    backward(result, cotangent_);
  }
  void zero_grad() override { network_->zero_grad(); }
  void set_training(bool on) override { network_->set_training(on); }
  std::vector<NamedTensor> parameters() const override { return network_->named_parameters(); }
  double computed_share() const override { return share_of(input_.sites()); }

 private:
  std::unique_ptr<Network> network_;
  Tensor input_, cotangent_;
};

class StageStep : public Step {
 public:
  explicit StageStep(const Workload& workload)
      : losses_(workload.net != "cascade"),
        cascade_({.network = {.image_size = workload.size, .width = workload.width},
                  .stage = workload.net == "stage1" ? 1 : 2,
                  .reconstruction = workload.net == "stage2",
                  .checkpoint = workload.checkpoint,
                  .skip = workload.skip ? Skip::kSupport : Skip::kNone,
                  .illumination_downscale = workload.illumination_downscale}) {
    cascade_.initialize(1);
    const Variant variant = cascade_.options().network.variant;
    const int64_t b = workload.batch;
    const int64_t s = workload.size;
    input_.image = random_uniform({b, s, s, cascade_.options().network.input_channels}, 0);
    input_.bsdf = random_uniform({b, s, s, kBsdfChannels}, 1);
    targets_.mask = make_mask(workload);
    input_.mask = targets_.mask;
    targets_.normal = random_uniform({b, s, s, 3}, 2);
    targets_.depth = random_uniform({b, s, s, 1}, 3);
    targets_.illumination = random_uniform({b, illumination_values(variant)}, 4);
    targets_.sss = random_uniform({b, sss_values(variant)}, 5);
    targets_.reconstruction = random_uniform({b, s, s, kBsdfChannels}, 6);
  }
  Tensor forward() override {
    if (!losses_) return cascade_.forward(input_).sss;
    const LossOptions losses;
    const CascadeWanted wanted = wanted_outputs(losses, cascade_.options());
    return compute_losses(losses, cascade_.forward(input_, wanted), targets_).total;
  }
  void go_backward(const Tensor& result) override { backward(result); }
  void zero_grad() override { cascade_.zero_grad(); }
  void set_training(bool on) override { cascade_.set_training(on); }
  std::vector<NamedTensor> parameters() const override { return cascade_.named_parameters(); }
  double computed_share() const override {
    return cascade_.options().skip == Skip::kNone ? 1.0 : share_of(support_of(targets_.mask));
  }

 private:
  bool losses_;
  Cascade cascade_;
  CascadeInput input_;
  LossTargets targets_;
};

bool is_network(std::string_view name) {
  return std::ranges::find(kNetworkNames, name) != kNetworkNames.end();
}

}  // namespace

Tensor random_uniform(Shape shape, uint32_t sample, double low, double high) {
  return noise(std::move(shape), sample, [=](Random& random) { return random.uniform(low, high); });
}

Tensor random_normal(Shape shape, uint32_t sample, double deviation) {
  return noise(std::move(shape), sample, [=](Random& random) { return deviation * random.normal(); });
}

void RelativeError::add(const Tensor& value, const Tensor& reference) {
  if (value.shape() != reference.shape()) {
    fail("bench", "compares {} with {}", to_string(value.shape()), to_string(reference.shape()));
  }
  const Tensor v = value.to(DType::kFloat64), r = reference.to(DType::kFloat64);
  for (int64_t i = 0; i < v.numel(); ++i) {
    const double expected = r.data<double>()[i], d = v.data<double>()[i] - expected;
    difference_ += d * d;
    size_ += expected * expected;
  }
}

double RelativeError::value() const {
  return std::sqrt(size_ > 0.0 ? difference_ / size_ : difference_);
}

Shape input_shape(std::string_view net, int64_t batch, int64_t size) {
  const NetworkOptions released;
  if (net == "illumination_decoder") return {batch, illumination_values(released.variant)};
  int64_t channels = released.input_channels;
  if (net == "sss") channels += 5;  // illumination map, normal and depth
  if (net == "reconstruction") channels = kBsdfChannels + sss_values(released.variant);
  return {batch, size, size, channels};
}

std::vector<std::string> workload_names() {
  std::vector<std::string> names(kNetworkNames.begin(), kNetworkNames.end());
  names.insert(names.end(), {"stage1", "stage2", "cascade"});
  return names;
}

std::unique_ptr<Step> make_step(const Workload& workload) {
  if (!is_network(workload.net)) return std::make_unique<StageStep>(workload);
  return std::make_unique<NetworkStep>(workload);
}

}  // namespace opaline::cli
