#include "cli/bench_error.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/clock.h"

namespace opaline::cli {
namespace {

/// White, as networks see it: they clip there.
constexpr double kWhite = 2.0;

Errors compare(const render::SceneRender& image, const Reference& reference) {
  Errors errors;
  for (size_t pixel = 0; pixel < reference.covered.size(); ++pixel) {
    if (!reference.covered[pixel]) continue;
    for (size_t k = 0; k < 9; ++k) {
      const size_t i = 9 * pixel + k;
      const double value = image.image[i], truth = reference.mean[i], variance = reference.variance[i];
      errors.stokes[k / 3] += (value - truth) * (value - truth) - variance;
      if (k >= 3) continue;
      const double difference = std::min(value, kWhite) - std::min(truth, kWhite);
      errors.clipped += difference * difference - (truth < kWhite ? variance : 0.0);
    }
  }
  const double scale = 1.0 / (3.0 * static_cast<double>(std::max<int64_t>(reference.pixels, 1)));
  for (double& mse : errors.stokes) mse *= scale;
  errors.clipped *= scale;
  return errors;
}

using Options = render::RenderOptions;
constexpr std::array<Saving, 9> kSavings = {{
    {"guide", [](Options& o) { o.savings.guide = false; }},
    {"guide by need", [](Options& o) { o.savings.guide_by_need = false; }},
    {"light paths", [](Options& o) { o.savings.light_paths = false; }},
    {"counts by part", [](Options& o) { o.savings.parts = false; }},
    {"counts by pixel", [](Options& o) { o.savings.pixels = false; }},
    {"shared paths", [](Options& o) { o.savings.shared_paths = false; }},
    {"background", [](Options& o) { o.savings.background = false; }},
    {"bounded queries", [](Options& o) { o.savings.bounded_queries = false; }},
    {"even samples", [](Options& o) { o.savings.even_samples = false; }},
}};

}  // namespace

std::span<const Saving> savings() {
  return kSavings;
}

double Reference::mean_s0() const {
  double sum = 0.0;
  for (size_t pixel = 0; pixel < covered.size(); ++pixel) {
    if (!covered[pixel]) continue;
    for (size_t c = 0; c < 3; ++c) sum += mean[9 * pixel + c];
  }
  return sum / (3.0 * static_cast<double>(std::max<int64_t>(pixels, 1)));
}

std::array<double, 4> ErrorPoint::efficiency() const {
  std::array<double, 4> result{};
  for (size_t i = 0; i < result.size(); ++i) {
    if (mse[i] > 0.0 && cost.cpu > 0.0) result[i] = 1.0 / (mse[i] * cost.cpu);
  }
  return result;
}

render::SceneRender ErrorMeter::render(render::RenderOptions options) {
  options.seed = seed_;
  options.number = number_++;
  return render::render_scene(scene_, camera_, options);
}

Reference ErrorMeter::reference(int64_t spp, int64_t renders) {
  Reference result;
  const auto n = static_cast<double>(renders);
  for (int64_t k = 0; k < renders; ++k) {
    const render::SceneRender image = render({.spp = (spp + renders - 1) / renders});
    const size_t values = image.image.size();
    if (k == 0) {
      result.mean.resize(values);
      result.variance.resize(values);
      result.covered.assign(values / 9, true);
    }
    // Welford's update of mean and sum of squares.
    for (size_t i = 0; i < values; ++i) {
      const double before = image.image[i] - result.mean[i];
      result.mean[i] += before / static_cast<double>(k + 1);
      result.variance[i] += before * (image.image[i] - result.mean[i]);
    }
    for (size_t pixel = 0; pixel < result.covered.size(); ++pixel) {
      if (!(image.coverage[pixel] >= 1.0F)) result.covered[pixel] = false;
    }
    rendered_();
  }
  for (double& v : result.variance) v /= n * (n - 1.0);
  result.pixels = std::count(result.covered.begin(), result.covered.end(), true);
  result.spp = spp;
  return result;
}

ErrorPoint ErrorMeter::measure(const Reference& reference, const Setting& setting) {
  ErrorPoint point;
  point.setting = setting;
  double samples = 0.0;
  std::vector<double> cpu, wall;
  std::array<double, 4> sum{}, squares{};
  for (int64_t k = 0; k < setting.renders; ++k) {
    const double begin = wall_seconds();
    const double cpu_begin = process_cpu_seconds();
    const render::SceneRender image = render(setting.options);
    samples += image.spp / static_cast<double>(setting.renders);
    cpu.push_back(process_cpu_seconds() - cpu_begin);
    wall.push_back(wall_seconds() - begin);
    const std::array<double, 4> errors = compare(image, reference).all();
    for (size_t i = 0; i < errors.size(); ++i) {
      sum[i] += errors[i];
      squares[i] += errors[i] * errors[i];
    }
    rendered_();
  }
  point.samples = samples;
  point.cost = {median(cpu), median(wall)};
  const auto n = static_cast<double>(setting.renders);
  for (size_t i = 0; i < sum.size(); ++i) {
    point.mse[i] = sum[i] / n;
    if (setting.renders > 1) {
      const double variance = std::max(0.0, squares[i] - n * point.mse[i] * point.mse[i]) / (n - 1.0);
      point.standard_error[i] = std::sqrt(variance / n);
    }
  }
  return point;
}

double error_slope(std::span<const ErrorPoint> points, size_t error, bool over_samples) {
  double n = 0.0, x = 0.0, y = 0.0, xx = 0.0, xy = 0.0;
  for (const ErrorPoint& point : points) {
    if (!(point.mse[error] > 0.0 && point.cost.cpu > 0.0)) continue;
    const double u = std::log(over_samples ? point.samples : point.cost.cpu), v = std::log(point.mse[error]);
    n += 1.0;
    x += u;
    y += v;
    xx += u * u;
    xy += u * v;
  }
  const double spread = n * xx - x * x;
  return n >= 2.0 && spread > 0.0 ? (n * xy - x * y) / spread : std::numeric_limits<double>::quiet_NaN();
}

double mean_efficiency(std::span<const ErrorPoint> points, size_t error) {
  double n = 0.0, sum = 0.0;
  for (const ErrorPoint& point : points) {
    const double efficiency = point.efficiency()[error];
    if (!(efficiency > 0.0)) continue;
    n += 1.0;
    sum += std::log(efficiency);
  }
  return n > 0.0 ? std::exp(sum / n) : 0.0;
}

}  // namespace opaline::cli
