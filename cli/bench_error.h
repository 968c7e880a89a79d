// Error and time of the renderer on one scene.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <span>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "data/render/render.h"

namespace opaline::cli {

/// Seconds of the whole process (all threads), and on the wall.
struct Cost {
  double cpu = 0;
  double wall = 0;
};

/// A converged image: the mean over independent renders.
struct Reference {
  int64_t spp = 0;               ///< of all renders together
  std::vector<double> mean;      ///< H x W x 9, as SceneRender has it
  std::vector<double> variance;  ///< of that mean, from the spread of the renders
  std::vector<bool> covered;     ///< H x W: the object fills the pixel
  int64_t pixels = 0;            ///< that are covered

  /// Over the covered pixels and the colours.
  double mean_s0() const;
};

/// Mean square error over covered pixels and colours. The reference's own variance is subtracted, so it has
/// no bias; where the truth is that there is next to no error it may come out below zero.
struct Errors {
  std::array<double, 3> stokes{};  ///< S0, S1, S2
  double clipped = 0;              ///< of S0 after clipping at 2: white, as networks see it

  std::array<double, 4> all() const { return {stokes[0], stokes[1], stokes[2], clipped}; }
};
inline constexpr std::array<std::string_view, 4> kErrorNames = {"S0", "S1", "S2", "S0 clipped"};

/// What is rendered, and how often.
struct Setting {
  std::string name;  ///< as tables have it
  render::RenderOptions options{};
  int64_t renders = 4;
};

/// A setting's result.
struct ErrorPoint {
  Setting setting;
  double samples = 0;                      ///< scattered paths a pixel of the object
  Cost cost{};                             ///< of one render, median; with everything that is prepared for it
  std::array<double, 4> mse{};             ///< mean, in the order of kErrorNames
  std::array<double, 4> standard_error{};  ///< of that mean, from the spread of the renders

  /// 1 / (MSE x CPU time); 0 where the error is not positive.
  std::array<double, 4> efficiency() const;
};

/// Renders one scene again and again; each render has random numbers of its own.
class ErrorMeter {
 public:
  /// `rendered` is called after every render.
  ErrorMeter(const render::SceneModel& scene, const render::Camera& camera, uint64_t seed,
             std::function<void()> rendered)
      : scene_(scene), camera_(camera), seed_(seed), rendered_(std::move(rendered)) {}

  /// `renders` renders of spp / renders samples each.
  Reference reference(int64_t spp, int64_t renders);
  ErrorPoint measure(const Reference& reference, const Setting& setting);

 private:
  render::SceneRender render(render::RenderOptions options);

  const render::SceneModel& scene_;
  const render::Camera& camera_;
  uint64_t seed_;
  uint32_t number_ = 0;
  std::function<void()> rendered_;
};

/// Slope of log MSE over the logarithm of CPU time or of samples, by least squares: -1 for an estimate
/// without bias from independent samples. Over time it is steeper where preparing takes its share, over
/// samples where they are stratified. NaN with fewer than two positive errors.
double error_slope(std::span<const ErrorPoint> points, size_t error, bool over_samples);

/// Geometric mean of the points' efficiencies.
double mean_efficiency(std::span<const ErrorPoint> points, size_t error);

/// Something that the renderer saves time or error with, and how to go without.
struct Saving {
  std::string_view name;
  void (*off)(render::RenderOptions& options);
};
std::span<const Saving> savings();

}  // namespace opaline::cli
