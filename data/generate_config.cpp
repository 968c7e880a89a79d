#include "data/generate_config.h"

#include <fmt/format.h>
#include <fmt/ranges.h>

#include <algorithm>
#include <string_view>
#include <vector>

namespace opaline {
namespace {

render::Range read_range(const TomlTable& table, std::string_view key, const render::Range& otherwise,
                         const RealRange& limits) {
  const std::vector<double> values = table.reals(key, {otherwise.low, otherwise.high}, limits, 2);
  if (values.size() != 2) return otherwise;
  if (!(values[0] <= values[1])) {
    table.error(key, fmt::format("[{}, {}] has its ends the wrong way round", values[0], values[1]));
    return otherwise;
  }
  return {values[0], values[1]};
}

std::vector<render::Family> read_families(const TomlTable& table) {
  const std::vector<std::string> names(render::kFamilyNames.begin(), render::kFamilyNames.end());
  std::vector<render::Family> families;
  for (const std::string& name : table.texts("families", names)) {
    const auto found = std::find(names.begin(), names.end(), name);
    if (found == names.end()) {
      const std::string near = did_you_mean(name, names);
      table.error("families", fmt::format("there is no family \"{}\"{}; there are {}", name,
                                          near.empty() ? "" : fmt::format(" (did you mean \"{}\"?)", near),
                                          fmt::join(names, ", ")));
      continue;
    }
    families.push_back(static_cast<render::Family>(found - names.begin()));
  }
  if (families.empty()) table.error("families", "names no family of shapes");
  return families;
}

}  // namespace

std::string GenerateConfig::text() const {
  std::vector<std::string_view> names;
  for (const render::Family family : ranges.families) {
    names.push_back(render::kFamilyNames[static_cast<size_t>(family)]);
  }
  const auto range = [](const render::Range& r) { return fmt::format("[{}, {}]", r.low, r.high); };
  std::string result = fmt::format(
      "seed = {}\nsize = {}\nspp = {}\nerror = {}\ndop_error = {}\nbsdf = \"{}\"\nphotons = {}\nfamilies = "
      "[\"{}\"]\nradius = {}\n"
      "offset = {}\nbump = {}\nsigma_t = {}\nalbedo = {}\ng = {}\nflash = {}\nenvironment = {}\n"
      "contrast = {}\nlamp = {}\n",
      seed, camera.width, spp, error, dop_error, render::kBsdfReadingNames[static_cast<size_t>(bsdf)],
      photons, fmt::join(names, "\", \""), range(ranges.radius), ranges.offset, ranges.bump,
      range(ranges.sigma_t), range(ranges.albedo), range(ranges.g), range(ranges.flash),
      range(ranges.environment), range(ranges.room.contrast), range(ranges.room.lamp));
  if (assets.any()) {
    result += fmt::format(
        "objects = \"{}\"\nobject_share = {}\nbumps = \"{}\"\nbump_share = {}\npanoramas = \"{}\"\n"
        "panorama_share = {}\npanorama_height = {}\ntest_share = {}\n",
        assets.objects, ranges.object_share, assets.bumps, ranges.bump_share, assets.panoramas,
        ranges.panorama_share, assets.panorama_height, assets.test_share);
  }
  return result;
}

GenerateConfig read_generate_config(const TomlTable& table) {
  GenerateConfig c;
  render::SceneRanges& r = c.ranges;
  c.train = table.integer("train", c.train, {.min = 0, .max = 100'000'000});
  c.test = table.integer("test", c.test, {.min = 0, .max = 100'000'000});
  c.seed = static_cast<uint64_t>(table.integer("seed", 1, {.min = 0}));
  c.camera.width = c.camera.height =
      static_cast<int>(table.integer("size", c.camera.width, {.min = 16, .max = 4096}));
  c.spp = table.integer("spp", c.spp, {.min = 1, .max = 1'000'000});
  c.error = table.real("error", c.error, {.min = 0.0, .max = 10.0});
  if (c.error > 0.0 && c.error < 1e-4) table.error("error", "is below 1e-4; 0 is for a fixed spp");
  c.dop_error = table.real("dop_error", c.dop_error, {.min = 0.0, .max = 10.0});
  if (c.dop_error > 0.0 && !(c.error > 0.0)) table.error("dop_error", "needs error, which plans the samples");
  c.bsdf = table.choice("bsdf", "clear", render::kBsdfReadingNames) == "clear"
               ? render::BsdfReading::kClear
               : render::BsdfReading::kReflection;
  c.photons = table.integer("photons", c.photons, {.min = 0, .max = 100'000'000});
  r.families = read_families(table);
  r.radius = read_range(table, "radius", r.radius, {.min = 0.01, .max = render::kCube});
  r.offset = table.real("offset", r.offset, {.min = 0.0, .max = render::kCube});
  if (!(r.radius.high + r.offset <= render::kCube)) {
    table.error("offset", fmt::format("{} and a radius of {} leave the cube of half-width {}", r.offset,
                                      r.radius.high, render::kCube));
  }
  r.bump = table.real("bump", r.bump, {.min = 0.0, .max = 1.0});
  r.sigma_t = read_range(table, "sigma_t", r.sigma_t, {.min = 0.0, .max = 32.0});
  r.albedo = read_range(table, "albedo", r.albedo, {.min = 0.0, .max = 1.0});
  r.g = read_range(table, "g", r.g, {.min = -0.99, .max = 0.99});
  r.flash = read_range(table, "flash", r.flash, {.min = 0.0, .max = 1e4});
  r.environment = read_range(table, "environment", r.environment, {.min = 1e-6, .max = 1e3});
  r.room.contrast = read_range(table, "contrast", r.room.contrast, {.min = 1.0, .max = 1e7});
  r.room.lamp = read_range(table, "lamp", r.room.lamp, {.min = 0.5, .max = 90.0});
  c.assets.objects = table.text("objects", "");
  r.object_share = table.real("object_share", r.object_share, {.min = 0.0, .max = 1.0});
  c.assets.bumps = table.text("bumps", "");
  r.bump_share = table.real("bump_share", r.bump_share, {.min = 0.0, .max = 1.0});
  c.assets.panoramas = table.text("panoramas", "");
  r.panorama_share = table.real("panorama_share", r.panorama_share, {.min = 0.0, .max = 1.0});
  c.assets.panorama_height =
      table.integer("panorama_height", c.assets.panorama_height, {.min = 16, .max = 4096});
  c.assets.test_share = table.real("test_share", c.assets.test_share, {.min = 0.0, .max = 1.0});
  return c;
}

}  // namespace opaline
