// `opaline bench noise`: the error of the scenes that a config renders, and what they cost.
#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <memory>
#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "cli/bench.h"
#include "core/clock.h"
#include "core/error.h"
#include "core/parallel.h"
#include "train/config.h"

namespace opaline::cli {
namespace {

struct Arguments {
  std::filesystem::path config;
  std::vector<std::string> set;
  int64_t scenes = 12;
  int threads = 0;
  bool json = false;
};

/// Light over this is white: images are clipped there.
constexpr double kWhite = 2.0;

/// Root-mean-square errors of one render over the object's whole pixels and colours.
struct Noise {
  int64_t pixels = 0;
  double s0 = 0.0;   ///< of S0 up to white, relative to its mean
  double dop = 0.0;  ///< of the degree of polarisation
};

/// From two independent renders: half the square of their difference is what each is off by.
Noise noise_between(const render::SceneRender& a, const render::SceneRender& b) {
  Noise noise;
  double light = 0.0;
  const auto dop = [](const render::SceneRender& r, size_t pixel, size_t c) {
    const double s0 = r.image[9 * pixel + c];
    return s0 > 0.0 ? std::hypot(r.image[9 * pixel + 3 + c], r.image[9 * pixel + 6 + c]) / s0 : 0.0;
  };
  for (size_t p = 0; p < a.coverage.size(); ++p) {
    if (!(a.coverage[p] >= 1.0F && b.coverage[p] >= 1.0F)) continue;
    ++noise.pixels;
    for (size_t c = 0; c < 3; ++c) {
      const double u = std::min(kWhite, double{a.image[9 * p + c]}),
                   v = std::min(kWhite, double{b.image[9 * p + c]});
      noise.s0 += 0.5 * (u - v) * (u - v);
      light += 0.5 * (u + v);
      const double difference = dop(a, p, c) - dop(b, p, c);
      noise.dop += 0.5 * difference * difference;
    }
  }
  const double n = 3.0 * static_cast<double>(std::max<int64_t>(noise.pixels, 1));
  noise.s0 = light > 0.0 ? std::sqrt(noise.s0 / n) / (light / n) : 0.0;
  noise.dop = std::sqrt(noise.dop / n);
  return noise;
}

void run_bench_noise(const Arguments& a) {
  const GenerateConfig config = load_run_config(a.config, a.set).render;
  if (config.assets.any())
    fail_usage("bench noise", "{}: scenes from folders are not measured here", a.config.string());
  set_num_threads(a.threads);
  double s0 = 0.0, dop = 0.0, seconds = 0.0;
  nlohmann::ordered_json rows = nlohmann::json::array();
  if (!a.json) fmt::print("scene  pixels  paths a pixel  error of S0  of DoP  CPU s  object\n");
  int64_t measured = 0;
  for (uint32_t number = 0; measured < a.scenes; ++number) {
    const double begin = process_cpu_seconds();
    const render::SceneModel scene = render::draw_scene(config.ranges, config.camera, config.seed, number);
    if (!render::likely_well_framed(scene, config.camera)) continue;  // would be drawn again
    ++measured;
    const double drawn = process_cpu_seconds();
    std::array<render::SceneRender, 2> renders;
    for (size_t i = 0; i < 2; ++i) {
      renders[i] = render_scene(scene, config.camera,
                                {.spp = config.spp,
                                 .error = config.error,
                                 .dop_error = config.dop_error,
                                 .bsdf = config.bsdf,
                                 .photons = config.photons,
                                 .seed = config.seed + i,
                                 .number = number});
    }
    const double cpu = drawn - begin + 0.5 * (process_cpu_seconds() - drawn);
    const Noise noise = noise_between(renders[0], renders[1]);
    s0 += noise.s0 * noise.s0;
    dop += noise.dop * noise.dop;
    seconds += cpu;
    if (a.json) {
      rows.push_back({{"number", number},
                      {"object", scene.object},
                      {"pixels", noise.pixels},
                      {"spp", renders[0].spp},
                      {"error", noise.s0},
                      {"dop_error", noise.dop},
                      {"cpu_s", cpu}});
    } else {
      fmt::print("{:>5}  {:>6}  {:>13.0f}  {:>9.2f} %  {:.4f}  {:>5.2f}  {}\n", number, noise.pixels,
                 renders[0].spp, 100.0 * noise.s0, noise.dop, cpu, scene.object);
      std::fflush(stdout);
    }
  }
  const auto n = static_cast<double>(a.scenes);
  const double hours = seconds / n * static_cast<double>(config.train + config.test) / 3600.0;
  if (a.json) {
    const nlohmann::ordered_json json = {{"scenes", rows},
                                         {"error", std::sqrt(s0 / n)},
                                         {"dop_error", std::sqrt(dop / n)},
                                         {"cpu_s", seconds / n},
                                         {"set_cpu_hours", hours}};
    fmt::print("{}\n", json.dump());
  } else {
    fmt::print(
        "root mean square over scenes: S0 {:.2f} %, DoP {:.4f}; {:.2f} CPU s a scene, {:.2f} CPU hours for "
        "the {} of "
        "the config\n",
        100.0 * std::sqrt(s0 / n), std::sqrt(dop / n), seconds / n, hours, config.train + config.test);
  }
}

}  // namespace

void add_bench_noise(CLI::App& bench) {
  const auto a = std::make_shared<Arguments>();
  CLI::App* command = bench.add_subcommand(
      "noise",
      "Error and CPU time of the scenes that a config renders, scene by scene: root mean square over the "
      "object's\n"
      "whole pixels and colours, S0 up to white relative to its mean, from two independent renders of each.");
  command->add_option("config", a->config, "TOML file with a [render] table")->required();
  command->add_option("--set", a->set, "table.key=value, wins over the file");
  command->add_option("--scenes", a->scenes, "The first so many")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--threads", a->threads, "0: all cores")->check(CLI::NonNegativeNumber);
  command->add_flag("--json", a->json, "Print one JSON object");
  command->callback([a] { run_bench_noise(*a); });
}

}  // namespace opaline::cli
