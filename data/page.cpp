#include "data/page.h"

#include <fmt/format.h>

#include "data/chart.h"

namespace opaline {
namespace {

constexpr std::string_view kStyle = R"(<style>
:root { color-scheme: light; }
body { font: 15px/1.5 system-ui, "DejaVu Sans", sans-serif; color: #1c2733; background: #f4f6f8; margin: 0; }
main { max-width: 1320px; margin: 0 auto; padding: 24px; }
h1 { font-size: 26px; margin: 0 0 4px; }
h2 { font-size: 19px; margin: 0 0 12px; }
section { background: #fff; border: 1px solid #dde3e9; border-radius: 8px; padding: 18px 22px; margin-top: 18px; overflow-x: auto; }
p.sub { margin: 0 0 8px; color: #5a6876; }
.cards + table { font-size: 14px; } .cards + table th, .cards + table td { padding: 5px 8px; }
.cards { display: grid; grid-template-columns: repeat(auto-fit, minmax(150px, 1fr)); gap: 10px; margin-bottom: 16px; }
.card { border: 1px solid #dde3e9; border-radius: 8px; padding: 8px 9px; }
.card b { display: block; font-size: 24px; }
.card span { color: #5a6876; font-size: 12px; white-space: nowrap; }
.card span.good { color: #1b7f4b; } .card span.bad { color: #b3372f; }
.good { color: #1b7f4b; } .bad { color: #b3372f; } .warning { color: #a8640a; } .undecided { color: #5a6876; }
table.words td { text-align: left; white-space: normal; vertical-align: top; } table.words th { text-align: left; }
table.words td:first-child { white-space: nowrap; }
.list { margin: 0; padding-left: 18px; font-size: 13px; overflow-wrap: anywhere; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { text-align: right; padding: 5px 11px; border-bottom: 1px solid #e6ebf0; white-space: nowrap; }
th:first-child, td:first-child { text-align: left; }
th { color: #5a6876; font-weight: 600; }
table.small { font-size: 11px; margin-top: 4px; } table.small th, table.small td { padding: 1px 5px; }
.charts { display: flex; flex-wrap: wrap; gap: 14px; }
.beside { display: flex; gap: 36px; align-items: flex-start; } .beside .charts { flex: 1; }
.chart .title { font-size: 13px; font-weight: 600; fill: #1c2733; }
.chart .tick { font-size: 11px; fill: #5a6876; } .chart .note { font-size: 11px; fill: #b3372f; }
.chart .grid { stroke: #e6ebf0; } .chart .axis { stroke: #8b98a5; }
.chart .mark { stroke: #8b98a5; stroke-dasharray: 4 4; } .chart .reference { stroke: #b3372f; stroke-dasharray: 5 4; }
.scene { display: flex; flex-wrap: wrap; gap: 8px; align-items: flex-start; padding: 10px 0; border-top: 1px solid #e6ebf0; }
.facts { flex: none; width: 262px; font-size: 13px; }
.scene figure { flex: 1 1 96px; max-width: 128px; }
figure { margin: 0; } figure img { width: 100%; max-width: 126px; height: auto; display: block; border: 1px solid #dde3e9; image-rendering: pixelated; }
figcaption { font-size: 11px; color: #5a6876; text-align: center; }
.legend { font-size: 12px; color: #5a6876; margin-right: 24px; }
.legend i { display: inline-block; width: 120px; height: 10px; margin: 0 4px; border-radius: 2px; }
pre { font: 12px/1.45 "DejaVu Sans Mono", monospace; overflow-x: auto; margin: 8px 0 0; }
</style>
)";

}  // namespace

std::string html_page(std::string_view title, std::string_view body) {
  return fmt::format(
      "<!doctype html>\n<html lang='en'><head><meta charset='utf-8'>"
      "<meta name='viewport' content='width=device-width, initial-scale=1'>"
      "<title>{}</title>\n{}</head><body><main>\n{}</main></body></html>\n",
      title, kStyle, body);
}

std::string html_section(std::string_view title, std::string_view body) {
  return body.empty() ? std::string() : fmt::format("<section><h2>{}</h2>{}</section>\n", title, body);
}

std::string html_figure(const Picture& picture, std::string_view caption) {
  const std::string text = escape_html(caption);
  return fmt::format("<figure><img src='{}' alt='{}'><figcaption>{}</figcaption></figure>", data_uri(picture),
                     text, text);
}

}  // namespace opaline
