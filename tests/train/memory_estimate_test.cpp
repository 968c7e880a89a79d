// The estimate of memory against what training then takes from the pool.
#include "train/memory_estimate.h"

#include <catch2/catch.hpp>

#include "core/memory.h"
#include "tests/train/synthetic.h"
#include "train/stage.h"

namespace opaline {
namespace {

using Catch::Matchers::Contains;

RunConfig config_of(std::vector<std::string> overrides) {
  return parse_run_config("[data]\ncache_mib = 0\n[model]\nwidth = 8\n[train]\nbatch = 8\nmicro_batch = 8\n",
                          "test.toml", overrides);
}

/// Peak of the pool in one step, parameters included.
int64_t peak_of_step(const RunConfig& config, int stage, int size) {
  const int64_t before = tensor_pool().bytes_in_use();
  const test::SyntheticDataset dataset({.train = 8, .test = 0, .size = size});
  std::vector<Sample> samples;
  for (int64_t i = 0; i < 8; ++i) {
    samples.push_back(encode_scene(dataset.load(Split::kTrain, i, {}), config.model.encode));
  }
  const Batch batch = make_batch(samples);
  samples.clear();
  Stage trained(config, stage);
  tensor_pool().reset_peak();
  trained.step(
      std::vector<int64_t>{8}, [&] { return batch; }, 1.0);
  return tensor_pool().peak_bytes() - before;
}

TEST_CASE("the estimate of memory is near what a step takes") {
  const auto [size, epochs2, stage] =
      GENERATE(table<int, int, int>({{32, 1, 2}, {64, 1, 2}, {96, 1, 2}, {64, 0, 1}}));
  const bool checkpointing = GENERATE(false, true);
  const RunConfig config = config_of({"model.image_size=" + std::to_string(size), "data.prefetch=1",
                                      "stage2.epochs=" + std::to_string(epochs2),
                                      fmt::format("train.activation_checkpointing={}", checkpointing)});
  const MemoryEstimate estimate = estimate_memory(config, size, size);
  const auto peak = static_cast<double>(peak_of_step(config, stage, size));
  const auto total = static_cast<double>(estimate.total());
  INFO("size " << size << ", stage " << stage << ": estimated " << total << ", used " << peak);
  CHECK(total > 0.9 * peak);
  CHECK(total < 2.2 * peak);  // read-ahead and the pool's overhead come on top
}

TEST_CASE("memory that will not suffice is said, with what to lower") {
  const MemoryEstimate estimate{
      .parameters = int64_t{1} << 30, .activations = int64_t{2} << 30, .data = int64_t{1} << 30};
  CHECK_THAT(describe(estimate, int64_t{8} << 30), Contains("about 4.00 GiB") && !Contains("warning"));
  CHECK_THAT(describe(estimate, int64_t{3} << 30),
             Contains("warning") && Contains("micro_batch") && Contains("3.00 GiB"));
  CHECK_THAT(describe(estimate, std::nullopt), !Contains("free"));
  REQUIRE(available_memory());
  CHECK(*available_memory() > int64_t{1} << 20);
}

}  // namespace
}  // namespace opaline
