// Training in float32 against a twin in float64: the same start, batches and rates.
#include <array>
#include <catch2/catch.hpp>
#include <cmath>
#include <cstring>
#include <map>
#include <memory>
#include <numeric>
#include <string>
#include <vector>

#include "core/autograd.h"
#include "core/numerics.h"
#include "core/parallel.h"
#include "core/random.h"
#include "nn/schedule.h"
#include "tests/train/synthetic.h"
#include "train/stage.h"

namespace opaline {
namespace {

// Image size, width and rates as small as they go; otherwise the recipe.
RunConfig small_config(std::vector<std::string> overrides = {}) {
  return parse_run_config("[model]\nimage_size = 32\nwidth = 4\n", "twin.toml", overrides);
}

std::vector<Sample> encode(const RunConfig& config, Split split, int64_t count) {
  const test::SyntheticDataset dataset({.train = count, .test = count});
  std::vector<Sample> samples;
  for (int64_t i = 0; i < count; ++i) {
    samples.push_back(encode_scene(dataset.load(split, i, {}), config.model.encode));
  }
  return samples;
}

Batch batch_of(const std::vector<Sample>& samples, const std::vector<int64_t>& which, DType dtype) {
  std::vector<Sample> chosen;
  for (const int64_t i : which) chosen.push_back(samples[static_cast<size_t>(i)]);
  Batch batch = make_batch(chosen);
  for (Tensor* t : {&batch.input, &batch.bsdf, &batch.mask, &batch.normal, &batch.depth, &batch.illumination,
                    &batch.sss, &batch.polarised}) {
    if (t->defined()) *t = t->to(dtype);
  }
  return batch;
}

/// What Stage does with one micro-batch, in either type.
class Twin {
 public:
  Twin(const RunConfig& config, int stage, DType dtype)
      : loss_(config.loss), cascade_(options(config, stage, dtype)) {
    cascade_.initialize(config.train.seed);
    cascade_.set_training(true);
    adam_ = std::make_unique<Adam>(cascade_.named_parameters(), adam_options(config, stage));
  }

  Losses losses(const Batch& batch) {
    const CascadeOutput out = cascade_.forward({.image = batch.input, .bsdf = batch.bsdf, .mask = batch.mask},
                                               wanted_outputs(loss_, cascade_.options()));
    return compute_losses(loss_, out, loss_targets(batch));
  }

  /// The loss before the step. The gradients stay.
  double step(const Batch& batch, double rate_factor) {
    cascade_.zero_grad();
    const Losses found = losses(batch);
    backward(found.total);
    adam_->step(rate_factor);
    return found.total.item();
  }

  /// In evaluation mode.
  double evaluate(const Batch& batch) {
    const NoGradGuard no_grad;
    cascade_.set_training(false);
    const double loss = losses(batch).total.item();
    cascade_.set_training(true);
    return loss;
  }

  Cascade& cascade() { return cascade_; }

 private:
  static CascadeOptions options(const RunConfig& config, int stage, DType dtype) {
    CascadeOptions result = cascade_options(config, stage);
    result.network.dtype = dtype;
    return result;
  }

  LossOptions loss_;
  Cascade cascade_;
  std::unique_ptr<Adam> adam_;
};

std::vector<int64_t> first(int64_t count) {
  std::vector<int64_t> list(static_cast<size_t>(count));
  std::iota(list.begin(), list.end(), 0);
  return list;
}

TEST_CASE("the float32 twin is a stage of training, bit by bit") {
  const ThreadsGuard one_thread(1);
  for (const int number : {1, 2}) {
    const RunConfig config = small_config();
    const Batch batch = batch_of(encode(config, Split::kTrain, 8), first(8), DType::kFloat32);
    Twin twin(config, number, DType::kFloat32);
    Stage stage(config, number);
    for (int i = 0; i < 3; ++i) {
      const StepOutcome outcome = stage.step(
          std::vector<int64_t>{8}, [&] { return batch; }, 0.5);
      CHECK(outcome.losses.at("total") == twin.step(batch, 0.5));
    }
    const auto ours = stage.cascade().named_parameters(), twins = twin.cascade().named_parameters();
    for (size_t i = 0; i < ours.size(); ++i) {
      INFO(ours[i].name);
      REQUIRE(std::memcmp(ours[i].tensor.bytes(), twins[i].tensor.bytes(),
                          static_cast<size_t>(ours[i].tensor.byte_size())) == 0);
    }
  }
}

struct Distance {
  double weights = 0.0, gradients = 0.0;  ///< |float32 - float64| / |float64| over all parameters
};

Distance distance(Twin& narrow, Twin& wide) {
  const auto a = narrow.cascade().named_parameters(), b = wide.cascade().named_parameters();
  std::array<double, 4> squares{};
  const auto add = [&](const Tensor& p, const Tensor& q, size_t at) {
    for (int64_t k = 0; k < q.numel(); ++k) {
      squares[at] += std::pow(p.at(k) - q.at(k), 2.0);
      squares[at + 1] += std::pow(q.at(k), 2.0);
    }
  };
  for (size_t i = 0; i < a.size(); ++i) {
    add(a[i].tensor, b[i].tensor, 0);
    add(a[i].tensor.grad(), b[i].tensor.grad(), 2);
  }
  return {.weights = std::sqrt(squares[0] / squares[1]), .gradients = std::sqrt(squares[2] / squares[3])};
}

// Rounding decides what a ReLU does to a value next to zero, Adam makes a whole step of a gradient that is
// rounding, and each step multiplies the difference: hence bounds that grow.
TEST_CASE("ten steps in float32 stay beside float64") {
  const ThreadsGuard one_thread(1);
  for (const Numerics numerics : {Numerics::kStrict, Numerics::kBalanced, Numerics::kFast}) {
    for (const int stage : {1, 2}) {
      const NumericsGuard guard(numerics);
      const RunConfig config = small_config();
      const auto samples = encode(config, Split::kTrain, 8);
      const Batch narrow_batch = batch_of(samples, first(8), DType::kFloat32);
      const Batch wide_batch = batch_of(samples, first(8), DType::kFloat64);
      Twin narrow(config, stage, DType::kFloat32), wide(config, stage, DType::kFloat64);
      for (int i = 0; i < 10; ++i) {
        const double loss = narrow.step(narrow_batch, 1.0), expected = wide.step(wide_batch, 1.0);
        const Distance d = distance(narrow, wide);
        INFO(to_string(numerics) << " stage " << stage << " step " << i << ": loss " << loss << ", "
                                 << expected << "; weights " << d.weights << ", gradients " << d.gradients);
        CHECK(std::abs(loss - expected) <= (i < 3 ? 1e-5 : 2e-3) * expected);
        CHECK(d.weights <= 5e-3);
        if (i == 0) CHECK(d.gradients <= 1e-4);
      }
    }
  }
}

struct LongRun {
  double train = 0.0, test = 0.0;  ///< losses after the last step
};

LongRun train(uint64_t seed, DType dtype, int64_t steps) {
  constexpr int64_t kScenes = 64, kBatch = 8;
  const RunConfig config = small_config({fmt::format("train.seed={}", seed), "loss.depth.weight=0"});
  const auto samples = encode(config, Split::kTrain, kScenes);
  Twin twin(config, 1, dtype);
  std::vector<int64_t> order = first(kScenes);
  for (int64_t step = 0; step < steps; ++step) {
    if (step % (kScenes / kBatch) == 0) {
      Random random(seed, Purpose::kTest, static_cast<uint32_t>(step));
      shuffle(order, random);
    }
    const auto begin = order.begin() + step % (kScenes / kBatch) * kBatch;
    twin.step(batch_of(samples, {begin, begin + kBatch}, dtype), linear_decay_by_step(step, steps));
  }
  return {.train = twin.evaluate(batch_of(samples, first(kScenes), dtype)),
          .test = twin.evaluate(batch_of(encode(config, Split::kTest, kScenes), first(kScenes), dtype))};
}

/// Whether the means of two sets of results agree within two standard errors of their difference, whose own
/// spread is that between seeds.
void check_within_seed_noise(const std::vector<double>& narrow, const std::vector<double>& wide) {
  const auto n = static_cast<double>(wide.size());
  const auto mean = [&](const std::vector<double>& v) {
    return std::accumulate(v.begin(), v.end(), 0.0) / n;
  };
  double squares = 0.0;
  for (const auto* v : {&narrow, &wide}) {
    for (const double x : *v) squares += std::pow(x - mean(*v), 2.0);
  }
  const double seed_noise = std::sqrt(squares / (2.0 * (n - 1.0)));
  WARN("float32 " << mean(narrow) << ", float64 " << mean(wide) << ", standard deviation between seeds "
                  << seed_noise);
  CHECK(std::abs(mean(narrow) - mean(wide)) <= 2.0 * seed_noise * std::sqrt(2.0 / n));
}

TEST_CASE("ten thousand steps in float32 end within seed noise of float64", "[.long]") {
  const ThreadsGuard one_thread(1);
  std::map<DType, std::vector<double>> train_losses, test_losses;
  for (const uint64_t seed : {1, 2, 3}) {
    for (const DType dtype : {DType::kFloat32, DType::kFloat64}) {
      const LongRun result = train(seed, dtype, 10'000);
      WARN("seed " << seed << " " << to_string(dtype) << ": training scenes " << result.train
                   << ", test scenes " << result.test);
      train_losses[dtype].push_back(result.train);
      test_losses[dtype].push_back(result.test);
    }
  }
  check_within_seed_noise(train_losses[DType::kFloat32], train_losses[DType::kFloat64]);
  check_within_seed_noise(test_losses[DType::kFloat32], test_losses[DType::kFloat64]);
}

}  // namespace
}  // namespace opaline
