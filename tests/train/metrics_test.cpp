// Metrics against values worked out by hand.
#include "train/metrics.h"

#include <catch2/catch.hpp>
#include <cmath>
#include <limits>

namespace opaline {
namespace {

const std::vector<float> kAll = {1, 1};

TEST_CASE("normal_error is half the mean absolute difference, not normalised") {
  const std::vector<float> estimate = {2, 0, 0, 0, 0, 1};
  const std::vector<float> truth = {0, 0, 1, 0, 0, 1};
  CHECK(normal_error(estimate, truth, kAll) == Approx((2.0 + 0.0 + 1.0) / 2.0 / 3.0 / 2.0));
  CHECK(normal_error(estimate, truth, std::vector<float>{0, 1}) == 0.0);
  CHECK(normal_error(estimate, truth, std::vector<float>{0, 0}) == 0.0);  // empty mask
}

TEST_CASE("mean_angle_degrees ignores length and is exact at small angles") {
  const std::vector<float> truth = {0, 0, 1, 0, 0, 1};
  CHECK(mean_angle_degrees(std::vector<float>{5, 0, 0, 0, 0, 0.1F}, truth, kAll) == Approx(45.0));
  CHECK(mean_angle_degrees(std::vector<float>{0, 0, -1, 0, 0, 1}, truth, kAll) == Approx(90.0));
  const double tiny = mean_angle_degrees(std::vector<float>{1e-6F, 0, 1, 0, 0, 1}, truth, kAll);
  CHECK(tiny == Approx(1e-6 * 180.0 / M_PI / 2.0).epsilon(1e-4));
  CHECK(mean_angle_degrees(std::vector<float>{0, 0, 0, 0, 0, 1}, truth, kAll) == Approx(45.0));
}

TEST_CASE("depth_error_min_max takes each map to its own range") {
  const std::vector<float> mask = {1, 1, 1, 0};
  const std::vector<float> truth = {0, 1, 2, 100};
  CHECK(depth_error_min_max(std::vector<float>{10, 30, 50, -7}, truth, mask) == Approx(0.0).margin(1e-12));
  // 0, 1/4, 1 against 0, 1/2, 1.
  CHECK(depth_error_min_max(std::vector<float>{0, 1, 4, 0}, truth, mask) == Approx(0.25 / 3.0));
  // A constant map becomes 0: 0, 1/2, 1 are left.
  CHECK(depth_error_min_max(std::vector<float>{3, 3, 3, 0}, truth, mask) == Approx(0.5));
  CHECK(depth_error_min_max(truth, truth, std::vector<float>{0, 0, 0, 0}) == 0.0);
}

TEST_CASE("depth_error_aligned is free of scale and shift") {
  const std::vector<float> mask = {1, 1, 1, 1};
  const std::vector<float> truth = {0, 1, 2, 3};
  CHECK(depth_error_aligned(std::vector<float>{5, 3, 1, -1}, truth, mask) == Approx(0.0).margin(1e-12));
  // A constant: the mean 1.5 is left, 1.5 0.5 0.5 1.5 off.
  CHECK(depth_error_aligned(std::vector<float>{7, 7, 7, 7}, truth, mask) == Approx(1.0));
  // x = 0, 0, 1, 1: fitted means 0.5 and 2.5, each half off.
  CHECK(depth_error_aligned(std::vector<float>{0, 0, 1, 1}, truth, mask) == Approx(0.5));
}

TEST_CASE("NaN in an estimate is never a small error") {
  const float nan = std::numeric_limits<float>::quiet_NaN();
  CHECK(std::isnan(
      normal_error(std::vector<float>{nan, 0, 0, 0, 0, 1}, std::vector<float>{0, 0, 1, 0, 0, 1}, kAll)));
  CHECK(std::isnan(depth_error_aligned(std::vector<float>{nan, 1}, std::vector<float>{0, 1}, kAll)));
  CHECK(std::isnan(depth_error_min_max(std::vector<float>{nan, 1}, std::vector<float>{0, 1}, kAll)));
}

TEST_CASE("SSS errors: sigma_t as a share of 32 per metre, albedo and g as they are") {
  const std::vector<float> normal = {0, 0, 1};
  const std::vector<float> depth = {0.5F};
  const std::vector<float> mask = {1};
  const SssValues a{.g = 0.3F, .sigma_t = {16, 8, 0}, .albedo = {0.5F, 0.6F, 0.7F}, .flash = 0};
  const SssValues b{.g = 0.5F, .sigma_t = {0, 0, 0}, .albedo = {0.5F, 0.5F, 0.5F}, .flash = 0};
  const Metrics metrics = measure({normal, depth, a}, {normal, depth, b}, mask);
  CHECK(*metrics[static_cast<size_t>(Metric::kSigmaT)] == Approx(24.0 / 32.0 / 3.0));
  CHECK(*metrics[static_cast<size_t>(Metric::kAlbedo)] == Approx(0.1).epsilon(1e-5));
  CHECK(*metrics[static_cast<size_t>(Metric::kG)] == Approx(0.2).epsilon(1e-5));
  CHECK(*metrics[static_cast<size_t>(Metric::kAngularDegrees)] == 0.0);

  const Metrics without = measure({normal, depth, std::nullopt}, {normal, depth, b}, mask);
  CHECK_FALSE(without[static_cast<size_t>(Metric::kG)].has_value());
  CHECK_FALSE(
      mean_metrics(std::vector<Metrics>{metrics, without})[static_cast<size_t>(Metric::kG)].has_value());
}

TEST_CASE("bootstrap_interval has the width that the normal approximation gives") {
  std::vector<double> values;
  for (int i = 0; i < 400; ++i) values.push_back(i % 2);  // mean 1/2, standard error 1/40
  const Interval interval = bootstrap_interval(values, 3);
  CHECK(interval.low == Approx(0.5 - 1.96 / 40).margin(0.01));
  CHECK(interval.high == Approx(0.5 + 1.96 / 40).margin(0.01));
  const Interval again = bootstrap_interval(values, 3);
  CHECK(again.low == interval.low);
  CHECK(again.high == interval.high);
}

}  // namespace
}  // namespace opaline
