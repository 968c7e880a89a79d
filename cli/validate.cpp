// `opaline validate slab|furnace|fresnel|hg|sh|flash|stress`: known answers through the code that renders.
#include <fmt/format.h>

#include <memory>
#include <nlohmann/json.hpp>
#include <string>

#include "cli/commands.h"
#include "core/error.h"
#include "data/render/figures.h"
#include "data/render/stress.h"
#include "data/render/validate.h"
#include "data/scene_set.h"
#include "train/config.h"

namespace opaline::cli {
namespace {

using render::Estimate;

double parse_tau(const std::string& text) {
  if (text == "inf") return render::kInfinity;
  size_t used = 0;
  try {
    const double value = std::stod(text, &used);
    if (used == text.size()) return value;
  } catch (const std::exception&) {
  }
  fail_usage("validate slab", "--tau {} is neither a number nor inf", text);
}

void add_slab(CLI::App& parent) {
  struct Arguments {
    render::SlabOptions options;
    std::string tau = "inf", incidence = "normal";
    bool json = false;
  };
  const auto a = std::make_shared<Arguments>();
  CLI::App* command = parent.add_subcommand("slab", "Diffuse reflectance and transmittance of a layer");
  command->add_option("--albedo", a->options.albedo, "Scattering / extinction")->required();
  command->add_option("--g", a->options.g, "Mean cosine of scattering")->capture_default_str();
  command->add_option("--tau", a->tau, "Optical thickness, or inf")->capture_default_str();
  command->add_option("--n", a->options.index, "Index of refraction")->capture_default_str();
  command->add_option("--paths", a->options.paths, "Paths")->capture_default_str();
  command->add_option("--seed", a->options.seed, "Seed")->capture_default_str();
  command->add_option("--incidence", a->incidence, "normal or lambertian")
      ->check(CLI::IsMember({"normal", "lambertian"}))
      ->capture_default_str();
  command->add_flag("--json", a->json, "Print one JSON object");
  command->callback([a] {
    a->options.tau = parse_tau(a->tau);
    a->options.lambertian = a->incidence == "lambertian";
    const render::SlabResult r = render::validate_slab(a->options);
    if (a->json) {
      const nlohmann::ordered_json json = {{"Rd", r.reflected.mean},  {"Rd_se", r.reflected.standard_error},
                                           {"T", r.transmitted.mean}, {"T_se", r.transmitted.standard_error},
                                           {"specular", r.specular},  {"paths_per_s", r.paths_per_second}};
      fmt::print("{}\n", json.dump());
    } else {
      fmt::print("Rd {:.6f} +- {:.6f}   T {:.6f} +- {:.6f}   specular {:.6f}   {:.3g} paths/s\n",
                 r.reflected.mean, r.reflected.standard_error, r.transmitted.mean,
                 r.transmitted.standard_error, r.specular, r.paths_per_second);
    }
  });
}

/// A line of the furnace's table; false where the light is not what it should be.
bool print_furnace_line(std::string_view name, const Estimate& e, double expected) {
  // Four standard errors: eight figures a scene would fail three of them now and then.
  const bool good = std::abs(e.mean - expected) <= 4.0 * e.standard_error + 1e-9;
  fmt::print("  {:<28} {:+.5f} +- {:.5f}  expected {}  {}\n", name, e.mean, e.standard_error, expected,
             good ? "ok" : "FAILED");
  return good;
}

/// What scenes are drawn from; a data set's own config and seed, where that is what `path` names.
render::SceneRanges read_ranges(const std::filesystem::path& path, uint64_t& seed) {
  if (path.empty()) return {};
  if (!std::filesystem::is_directory(path)) return load_run_config(path).render.ranges;
  const SceneSetInfo info = read_scene_set_info(path);
  if (info.config_text.empty()) {
    fail_usage(path.string(), "does not say which [render] table it was rendered from");
  }
  seed = info.seed;
  return parse_run_config("[render]\n" + info.config_text, path.string()).render.ranges;
}

void add_furnace(CLI::App& parent, Outcome& outcome) {
  struct Arguments {
    std::filesystem::path config;
    render::FurnaceOptions options;
    uint32_t scenes = 4;
  };
  const auto a = std::make_shared<Arguments>();
  CLI::App* command = parent.add_subcommand("furnace",
                                            "Scenes in uniform light of radiance 1 that absorb nothing: S0 = "
                                            "1, and without their medium S1 = S2 = 0.\n"
                                            "Each figure may be off by four standard errors.");
  command->add_option(
      "config", a->config,
      "TOML file whose [render] table scenes are drawn from, or a data set that knows its own");
  command->add_option("--number", a->options.number, "First scene")->capture_default_str();
  command->add_option("--scenes", a->scenes, "Scenes")->capture_default_str();
  command->add_option("--paths", a->options.paths, "Paths a scene")->capture_default_str();
  command->add_option("--seed", a->options.seed, "Seed")->capture_default_str();
  command->callback([a, &outcome] {
    const render::SceneRanges ranges = read_ranges(a->config, a->options.seed);
    for (uint32_t i = 0; i < a->scenes; ++i, ++a->options.number) {
      const render::FurnaceResult r = render::validate_furnace(ranges, a->options);
      fmt::print("{} ({} of {} paths lost)\n", r.object, r.faults.lost, r.faults.paths);
      bool good = print_furnace_line("S0", r.s0, 1.0);
      for (size_t b = 0; b < 4; ++b) {
        const double low = 0.25 * static_cast<double>(b);
        const std::string name = fmt::format("S0, cosine {:.2f} to {:.2f}", low, low + 0.25);
        good = print_furnace_line(name, r.by_cosine[b], 1.0) && good;
      }
      for (size_t k = 0; k < 3; ++k) {
        const std::string name = fmt::format("S{} without the medium", k);
        good = print_furnace_line(name, r.clear[k], k == 0 ? 1.0 : 0.0) && good;
      }
      if (!good) outcome.exit_code = 1;
    }
  });
}

void print_figures(const std::vector<render::Figure>& figures, Outcome& outcome) {
  for (const render::Figure& f : figures) {
    fmt::print("{:<52} {:>11.7f} +- {:.7f}  expected {:>11.7f}  {}\n", f.name, f.value, f.standard_error,
               f.expected, f.passes() ? "ok" : "FAILED");
    if (!f.passes()) outcome.exit_code = 1;
  }
}

struct Sampling {
  int64_t paths;
  uint64_t seed = 1;
};

std::shared_ptr<Sampling> add_sampling(CLI::App& command, int64_t paths) {
  const auto s = std::make_shared<Sampling>(Sampling{.paths = paths});
  command.add_option("--paths", s->paths, "Paths of a figure")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command.add_option("--seed", s->seed, "Seed")->capture_default_str();
  return s;
}

void add_figures(CLI::App& parent, Outcome& outcome) {
  CLI::App* fresnel = parent.add_subcommand("fresnel", "Reflectances and degrees of polarisation");
  const auto of_fresnel = add_sampling(*fresnel, 1'000'000);
  fresnel->callback([of_fresnel, &outcome] {
    print_figures(render::validate_fresnel(of_fresnel->paths, of_fresnel->seed), outcome);
  });

  CLI::App* hg = parent.add_subcommand("hg", "Moments of the Henyey-Greenstein phase function");
  const auto of_hg = add_sampling(*hg, 1'000'000);
  const auto g = std::make_shared<std::vector<double>>(std::vector<double>{0.0, 1e-4, 0.5, 0.9, 0.99, -0.7});
  hg->add_option("--g", *g, "Mean cosines")->capture_default_str();
  hg->callback([of_hg, g, &outcome] {
    for (const double value : *g) {
      fmt::print("g = {}\n", value);
      print_figures(render::validate_hg(value, of_hg->paths, of_hg->seed), outcome);
    }
  });

  CLI::App* sh = parent.add_subcommand("sh", "Spherical harmonics of known lights, turned ones too");
  const auto rotations = std::make_shared<int>(4);
  const auto seed = std::make_shared<uint64_t>(1);
  sh->add_option("--rotations", *rotations, "Random axes")
      ->check(CLI::NonNegativeNumber)
      ->capture_default_str();
  sh->add_option("--seed", *seed, "Seed")->capture_default_str();
  sh->callback([=, &outcome] { print_figures(render::validate_sh(*rotations, *seed), outcome); });

  CLI::App* flash = parent.add_subcommand("flash", "Irradiance of the flash, pi L (r / d)^2");
  const auto of_flash = add_sampling(*flash, 8'000'000);
  flash->callback([of_flash, &outcome] {
    print_figures(render::validate_flash(of_flash->paths, of_flash->seed), outcome);
  });
}

void add_stress(CLI::App& parent, Outcome& outcome) {
  struct Arguments {
    render::StressOptions options;
    std::string only;
    double scale = 1.0;
  };
  const auto a = std::make_shared<Arguments>();
  CLI::App* command = parent.add_subcommand(
      "stress",
      "Extreme media and shapes in uniform light of radiance 1: samples that are no light, lost paths,\n"
      "and S0, which is 1 where nothing is absorbed");
  command->add_option("--paths", a->options.paths, "Paths a case")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->add_option("--seed", a->options.seed, "Seed")->capture_default_str();
  command->add_option("--only", a->only, "Cases whose name holds this text");
  command->add_option("--scale", a->scale, "Size of the bodies, at the same optical thickness")
      ->check(CLI::PositiveNumber)
      ->capture_default_str();
  command->callback([a, &outcome] {
    for (const render::StressCase& stress : render::stress_cases()) {
      if (stress.name.find(a->only) == std::string::npos) continue;
      const render::StressResult r =
          render::run_stress(a->scale == 1.0 ? stress : render::scaled(stress, a->scale), a->options);
      const bool good = r.passes(stress.lost_per_million);
      fmt::print("{:<46}", stress.name);
      for (const Estimate& e : r.s0) fmt::print(" {:.4f} +- {:.4f} ", e.mean, e.standard_error);
      fmt::print("clear {:.4f} +- {:.4f}  no light {}  lost {} of {} ({:.0f} per million)  {}\n",
                 r.clear.mean, r.clear.standard_error, r.not_finite, r.faults.lost, r.faults.paths,
                 r.lost_per_million(), good ? "ok" : "FAILED");
      if (!good) outcome.exit_code = 1;
    }
  });
}

}  // namespace

void add_validate(CLI::App& app, Outcome& outcome) {
  CLI::App* command = app.add_subcommand("validate", "Show that the renderer is right");
  command->require_subcommand(1);
  add_furnace(*command, outcome);
  add_slab(*command);
  add_figures(*command, outcome);
  add_stress(*command, outcome);
}

}  // namespace opaline::cli
