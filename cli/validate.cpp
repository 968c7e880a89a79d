// `opaline validate furnace|slab|fresnel`: known answers through the code that renders.
#include <fmt/format.h>

#include <memory>
#include <nlohmann/json.hpp>
#include <string>

#include "cli/commands.h"
#include "core/error.h"
#include "data/render/validate.h"
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
  command->add_option("config", a->config, "TOML file whose [render] table scenes are drawn from");
  command->add_option("--scenes", a->scenes, "Scenes")->capture_default_str();
  command->add_option("--paths", a->options.paths, "Paths a scene")->capture_default_str();
  command->add_option("--seed", a->options.seed, "Seed")->capture_default_str();
  command->callback([a, &outcome] {
    const render::SceneRanges ranges =
        a->config.empty() ? render::SceneRanges{} : load_run_config(a->config).render.ranges;
    for (uint32_t i = 0; i < a->scenes; ++i) {
      a->options.number = i;
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

void add_fresnel(CLI::App& parent, Outcome& outcome) {
  struct Arguments {
    int64_t paths = 1'000'000;
    uint64_t seed = 1;
  };
  const auto a = std::make_shared<Arguments>();
  CLI::App* command = parent.add_subcommand("fresnel", "Reflectances and degrees of polarisation");
  command->add_option("--paths", a->paths, "Paths of the averages")->capture_default_str();
  command->add_option("--seed", a->seed, "Seed")->capture_default_str();
  command->callback([a, &outcome] {
    for (const render::Figure& f : render::validate_fresnel(a->paths, a->seed)) {
      fmt::print("{:<40} {:>10.6f} +- {:.6f}  expected {:>10.6f}  {}\n", f.name, f.value, f.standard_error,
                 f.expected, f.passes() ? "ok" : "FAILED");
      if (!f.passes()) outcome.exit_code = 1;
    }
  });
}

}  // namespace

void add_validate(CLI::App& app, Outcome& outcome) {
  CLI::App* command = app.add_subcommand("validate", "Show that the renderer is right");
  command->require_subcommand(1);
  add_furnace(*command, outcome);
  add_slab(*command);
  add_fresnel(*command, outcome);
}

}  // namespace opaline::cli
