#include "data/check_page.h"

#include <fmt/format.h>

#include <algorithm>

#include "core/error.h"
#include "data/chart.h"
#include "data/check_parts.h"
#include "data/contact_sheet.h"
#include "data/page.h"

namespace opaline {
namespace {

constexpr int64_t kGallery = 8;      // scenes shown
constexpr int kTile = 128;           // pixels of their pictures
constexpr size_t kMostListed = 200;  // problems and warnings
constexpr size_t kFewScenes = 40;    // that have a table of their own
constexpr size_t kFewBins = 12;      // of histograms of few scenes
constexpr size_t kBins = 24;

std::string_view tone(Verdict verdict) {
  return verdict == Verdict::kBad ? "bad" : to_string(verdict);
}

std::string cards(const DatasetCheck& check) {
  std::string html = "<div class='cards'>";
  const auto card = [&](std::string_view name, int64_t value, std::string_view colour) {
    html += fmt::format("<div class='card'><span>{}</span><b class='{}'>{}</b></div>", name, colour, value);
  };
  for (const SplitCheck& split : check.splits) {
    card(fmt::format("{} scenes", to_string(split.split)), static_cast<int64_t>(split.scenes.size()), "");
  }
  card("problems", check.problem_count(), check.problem_count() > 0 ? "bad" : "good");
  card("warnings", check.warning_count(), check.warning_count() > 0 ? "warning" : "good");
  return html + "</div>";
}

std::string verdicts(const DatasetCheck& check) {
  std::string html =
      "<table class='words'><tr><th>looked at</th><th>verdict</th><th>found</th><th>expected</th></tr>";
  for (const Finding& f : check.findings) {
    html += fmt::format("<tr><td>{}</td><td class='{}'><b>{}</b></td><td>{}</td><td>{}</td></tr>",
                        escape_html(f.what), tone(f.verdict), tone(f.verdict), escape_html(f.found),
                        escape_html(f.expected));
  }
  return html + "</table>";
}

std::string problems(const DatasetCheck& check) {
  std::string html;
  size_t count = 0;
  const auto item = [&](std::string_view colour, const std::string& text) {
    if (count++ < kMostListed) html += fmt::format("<li class='{}'>{}</li>", colour, escape_html(text));
  };
  const auto of_scenes = [&](std::string_view colour, const auto& texts) {
    for (const SplitCheck& split : check.splits) {
      for (const SceneCheck& scene : split.scenes) {
        for (const std::string& text : texts(scene)) {
          item(colour, fmt::format("{} scene {}: {}", to_string(split.split), scene.id, text));
        }
      }
    }
  };
  for (const std::string& text : check.problems) item("bad", text);
  of_scenes(
      "bad", [](const SceneCheck& scene) -> const auto& { return scene.problems; });
  for (const std::string& text : check.warnings) item("warning", text);
  of_scenes(
      "warning", [](const SceneCheck& scene) -> const auto& { return scene.warnings; });
  if (count == 0) return {};
  if (count > kMostListed) html += fmt::format("<li>({} more)</li>", count - kMostListed);
  return "<ul class='list'>" + html + "</ul>";
}

std::string gallery(const Dataset& dataset) {
  std::string html =
      "<p class='sub'>DoP: black 0 to pale yellow 0.5. AoP: red 0, green 60, blue 120 degrees, dark where "
      "light is "
      "hardly polarised. Depth: white is nearest.</p>";
  for (const ScenePlace& place : spread_scenes(dataset, kGallery)) {
    const std::string id = dataset.id(place.split, place.index);
    html += fmt::format("<div class='scene'><div class='facts'><b>{} {}</b>", to_string(place.split),
                        escape_html(id));
    try {
      const Scene scene = dataset.load(place.split, place.index);
      if (scene.sigma_t) {
        const auto& s = *scene.sigma_t;
        html += fmt::format("<br>sigma_t {:.1f} {:.1f} {:.1f}", s[0], s[1], s[2]);
      }
      if (scene.albedo) {
        const auto& a = *scene.albedo;
        html += fmt::format("<br>albedo {:.2f} {:.2f} {:.2f}", a[0], a[1], a[2]);
      }
      if (scene.g) html += fmt::format("<br>g {:.2f}", *scene.g);
      if (scene.flash) html += fmt::format("<br>flash {:.0f}", *scene.flash);
      html += "</div>";
      for (const SceneTile& tile : scene_tiles(scene)) {
        html += html_figure(scaled_to(tile.picture, kTile), tile.name);
      }
    } catch (const Error&) {
      html += "<br><span class='bad'>cannot be read</span></div>";
    }
    html += "</div>";
  }
  return html;
}

std::string numbers(const SplitCheck& split) {
  std::string html = "<div class='beside'><table><tr><th></th><th>min</th><th>mean</th><th>max</th></tr>";
  const auto row = [&](std::string_view name, const Spread& s) {
    if (s.count == 0) return;
    html += fmt::format("<tr><td>{}</td><td>{:.4g}</td><td>{:.4g}</td><td>{:.4g}</td></tr>", name, s.min,
                        s.mean, s.max);
  };
  for (const Statistic& statistic : statistics()) row(statistic.name, spread(split, statistic.value));
  for (size_t i = 0; i < parameter_ranges().size(); ++i) {
    row(parameter_ranges()[i].name, spread(split, parameter_value(i)));
  }
  html += "</table>";
  if (spread(split, parameter_value(0)).count == 0) return html + "</div>";
  html += "<div class='charts'>";
  const size_t bins = split.scenes.size() < 10 * kBins ? kFewBins : kBins;
  for (size_t i = 0; i < parameter_ranges().size(); ++i) {
    const ParameterRange& range = parameter_ranges()[i];
    html += render_histogram(histogram(split, i, bins), "#2563a8",
                             {.title = std::string(range.name), .low = range.min, .high = range.max});
  }
  return html + "</div></div>";
}

std::string scene_table(const SplitCheck& split) {
  if (split.scenes.size() > kFewScenes) return {};
  std::string html = "<table><tr><th>scene</th>";
  for (const Statistic& statistic : statistics()) {
    if (spread(split, statistic.value).count > 0) html += fmt::format("<th>{}</th>", statistic.name);
  }
  html += "</tr>";
  for (const SceneCheck& scene : split.scenes) {
    html += fmt::format("<tr><td>{}</td>", escape_html(scene.id));
    for (const Statistic& statistic : statistics()) {
      if (spread(split, statistic.value).count == 0) continue;
      const std::optional<double> value = scene.read ? statistic.value(scene) : std::nullopt;
      html += value ? fmt::format("<td>{:.4g}</td>", *value) : "<td>-</td>";
    }
    html += "</tr>";
  }
  return html + "</table>";
}

}  // namespace

std::string check_page(const DatasetCheck& check, const Dataset& dataset) {
  const std::string root = check.facts.root.string();
  const std::string name =
      escape_html(std::filesystem::absolute(check.facts.root).lexically_normal().filename().string());
  std::string html =
      fmt::format("<h1>{}</h1><p class='sub'>{}, {} layout", name.empty() ? escape_html(root) : name,
                  escape_html(root), check.facts.layout);
  if (check.facts.width > 0) html += fmt::format(", {} x {} pixels", check.facts.width, check.facts.height);
  html += "</p>\n";
  html += html_section("Verdicts", cards(check) + verdicts(check));
  html += html_section("Problems and warnings", problems(check));
  html += html_section("Scenes", gallery(dataset));
  for (const SplitCheck& split : check.splits) {
    html += html_section(fmt::format("Numbers of {} scenes", to_string(split.split)), numbers(split));
  }
  for (const SplitCheck& split : check.splits) {
    html += html_section(fmt::format("Each of the {} scenes", to_string(split.split)), scene_table(split));
  }
  return html_page("opaline check-data: " + name, html);
}

}  // namespace opaline
