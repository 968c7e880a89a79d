#include "data/chart.h"

#include <fmt/format.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <string_view>

namespace opaline {
namespace {

constexpr double kLeft = 52.0;
constexpr double kRight = 12.0;
constexpr double kTop = 30.0;
constexpr double kBottom = 34.0;
constexpr int kTicks = 5;
// A log axis keeps this share of a decade free at both ends.
constexpr double kLogMargin = 0.05;

/// An axis: from values to pixels.
struct Axis {
  double low = 0.0;
  double high = 1.0;
  double begin = 0.0;  // pixel of low
  double end = 1.0;    // pixel of high
  bool log = false;

  double raw(double value) const { return log ? std::log10(value) : value; }
  double pixel(double value) const { return begin + (raw(value) - low) / (high - low) * (end - begin); }
  bool holds(double value) const { return std::isfinite(value) && (!log || value > 0.0); }
};

/// 1, 2 or 5 times a power of ten, so that about `count` steps cover the range.
double nice_step(double range, int count) {
  const double rough = range / count;
  const double power = std::pow(10.0, std::floor(std::log10(rough)));
  const double factor = rough / power;
  return power * (factor <= 1.0 ? 1.0 : factor <= 2.0 ? 2.0 : factor <= 5.0 ? 5.0 : 10.0);
}

struct Range {
  double low = std::numeric_limits<double>::infinity();
  double high = -std::numeric_limits<double>::infinity();
  void add(double value) {
    low = std::min(low, value);
    high = std::max(high, value);
  }
};

void fit(Axis& axis, Range range) {
  if (!(range.low <= range.high)) range = {0.0, 1.0};
  if (axis.log) {
    axis.low = std::log10(range.low) - kLogMargin;
    axis.high = std::log10(range.high) + kLogMargin;
  } else {
    const double margin = range.high > range.low ? 0.04 * (range.high - range.low) : 0.5;
    axis.low = range.low - margin;
    axis.high = range.high + margin;
  }
}

std::vector<double> ticks(const Axis& axis) {
  std::vector<double> values;
  if (axis.log) {
    // Whole decades where there are enough, else 1, 2 and 5 of each.
    const bool few = axis.high - axis.low < 2.0;
    for (double decade = std::floor(axis.low); decade <= axis.high; decade += 1.0) {
      for (const double factor : {1.0, 2.0, 5.0}) {
        const double value = factor * std::pow(10.0, decade);
        if (factor > 1.0 && !few) continue;
        if (std::log10(value) >= axis.low && std::log10(value) <= axis.high) values.push_back(value);
      }
    }
    return values;
  }
  const double step = nice_step(axis.high - axis.low, kTicks);
  for (double value = std::ceil(axis.low / step) * step; value <= axis.high; value += step) {
    values.push_back(std::abs(value) < 1e-9 * step ? 0.0 : value);
  }
  return values;
}

std::string line(double x1, double y1, double x2, double y2, std::string_view style) {
  return fmt::format("<line x1='{:.1f}' y1='{:.1f}' x2='{:.1f}' y2='{:.1f}' class='{}'/>", x1, y1, x2, y2,
                     style);
}

std::string draw_series(const ChartSeries& series, const ChartOptions& options, const Axis& x,
                        const Axis& y) {
  const bool line = options.lines && series.line;
  std::string path;
  std::string dots;
  for (const ChartPoint& point : series.points) {
    if (!x.holds(point.x) || !y.holds(point.y)) continue;
    const double px = x.pixel(point.x);
    const double py = y.pixel(point.y);
    path += fmt::format("{:.1f},{:.1f} ", px, py);
    if (series.markers || !line) {
      dots += fmt::format("<circle cx='{:.1f}' cy='{:.1f}' r='{}' fill='{}' fill-opacity='{}'/>", px, py,
                          line ? 2.5 : 2.0, series.colour, line ? 1.0 : 0.55);
    }
  }
  std::string out;
  if (line) {
    out += fmt::format(
        "<polyline points='{}' fill='none' stroke='{}' stroke-width='1.6' stroke-linejoin='round'/>", path,
        series.colour);
  }
  return out + dots;
}

}  // namespace

std::string chart_sheet(const std::vector<std::string>& charts, int columns, int width, int height) {
  const int count = static_cast<int>(charts.size()), rows = (count + columns - 1) / columns;
  std::string svg = fmt::format(
      "<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {0} {1}' width='{0}' height='{1}' "
      "font-family='sans-serif'>\n<style>.title {{ font-size: 13px; font-weight: 600; fill: #1c2733; }} "
      ".tick {{ font-size: 11px; fill: #5a6876; }} .grid {{ stroke: #e6ebf0; }} .axis {{ stroke: #8b98a5; }}"
      "</style>\n<rect width='{0}' height='{1}' fill='#ffffff'/>\n",
      std::min(count, columns) * width, rows * height);
  for (int k = 0; k < count; ++k) {
    svg += fmt::format("<g transform='translate({} {})'>{}</g>\n", k % columns * width, k / columns * height,
                       charts[static_cast<size_t>(k)]);
  }
  return svg + "</svg>\n";
}

std::string escape_html(std::string_view text) {
  std::string out;
  for (const char c : text) {
    switch (c) {
      case '&':
        out += "&amp;";
        break;
      case '<':
        out += "&lt;";
        break;
      case '>':
        out += "&gt;";
        break;
      case '"':
        out += "&quot;";
        break;
      case '\'':
        out += "&#39;";
        break;
      default:
        out += c;
    }
  }
  return out;
}

std::string render_chart(const std::vector<ChartSeries>& series, const ChartOptions& options) {
  const double width = options.width;
  const double height = options.height;
  Axis x{.begin = kLeft, .end = width - kRight, .log = options.log_x};
  Axis y{.begin = height - kBottom, .end = kTop, .log = options.log_y};
  Range x_range, y_range;
  for (const ChartSeries& one : series) {
    for (const ChartPoint& point : one.points) {
      if (!x.holds(point.x) || !y.holds(point.y)) continue;
      x_range.add(point.x);
      y_range.add(point.y);
    }
  }
  const bool empty = !(x_range.low <= x_range.high);
  if (options.reference && y.holds(*options.reference)) y_range.add(*options.reference);
  if (options.diagonal && !empty) {
    x_range.low = y_range.low = std::min(x_range.low, y_range.low);
    x_range.high = y_range.high = std::max(x_range.high, y_range.high);
  }
  fit(x, x_range);
  fit(y, y_range);

  std::string svg = fmt::format("<svg class='chart' viewBox='0 0 {0} {1}' width='{0}' height='{1}'>",
                                options.width, options.height);
  svg += fmt::format("<text x='{}' y='16' class='title'>{}</text>", kLeft - 40.0, escape_html(options.title));
  if (empty) {
    return svg +
           fmt::format("<text x='{}' y='{}' class='tick' text-anchor='middle'>no points yet</text></svg>",
                       width / 2.0, height / 2.0);
  }
  for (const double value : ticks(y)) {
    const double at = y.pixel(value);
    svg += line(x.begin, at, x.end, at, "grid");
    svg += fmt::format("<text x='{:.1f}' y='{:.1f}' class='tick' text-anchor='end'>{:.4g}</text>",
                       x.begin - 6.0, at + 3.5, value);
  }
  for (const double value : ticks(x)) {
    svg += fmt::format("<text x='{:.1f}' y='{:.1f}' class='tick' text-anchor='middle'>{:.6g}</text>",
                       x.pixel(value), y.begin + 14.0, value);
  }
  svg += line(x.begin, y.begin, x.end, y.begin, "axis");
  svg += fmt::format("<text x='{:.1f}' y='{:.1f}' class='tick' text-anchor='middle'>{}</text>",
                     (x.begin + x.end) / 2.0, height - 4.0, escape_html(options.x_label));
  for (const double mark : options.x_marks) {
    if (mark > x.low && mark < x.high) svg += line(x.pixel(mark), y.begin, x.pixel(mark), y.end, "mark");
  }
  if (options.diagonal) svg += line(x.begin, y.begin, x.end, y.end, "mark");
  if (options.reference && y.holds(*options.reference)) {
    const double at = y.pixel(*options.reference);
    svg += line(x.begin, at, x.end, at, "reference");
    svg += fmt::format("<text x='{:.1f}' y='{:.1f}' class='note' text-anchor='end'>{}</text>", x.end,
                       at - 4.0, escape_html(options.reference_name));
  }
  for (const ChartSeries& one : series) svg += draw_series(one, options, x, y);
  // The legend stands at the right of the title; a single series needs none.
  double at = width - kRight;
  for (size_t i = series.size(); series.size() > 1 && i-- > 0;) {
    svg += fmt::format("<text x='{:.1f}' y='16' class='tick' text-anchor='end' style='fill:{}'>{}</text>", at,
                       series[i].colour, escape_html(series[i].name));
    at -= 7.0 * static_cast<double>(series[i].name.size()) + 12.0;
  }
  return svg + "</svg>";
}

std::string render_histogram(const std::vector<int64_t>& counts, const std::string& colour,
                             const BarOptions& options) {
  constexpr double kMargin = 10.0;
  constexpr double kBelow = 20.0;
  const double base = options.height - kBelow;
  const double room = options.width - 2.0 * kMargin;
  const int64_t most = counts.empty() ? 0 : *std::max_element(counts.begin(), counts.end());
  std::string svg = fmt::format("<svg class='chart' viewBox='0 0 {0} {1}' width='{0}' height='{1}'>",
                                options.width, options.height);
  svg += fmt::format("<text x='{}' y='16' class='title'>{}</text>", kMargin, escape_html(options.title));
  svg += fmt::format("<text x='{}' y='16' class='tick' text-anchor='end'>at most {}</text>",
                     options.width - kMargin, most);
  const double step = counts.empty() ? room : room / static_cast<double>(counts.size());
  for (size_t i = 0; i < counts.size() && most > 0; ++i) {
    const double height = (base - kTop) * static_cast<double>(counts[i]) / static_cast<double>(most);
    svg += fmt::format("<rect x='{:.1f}' y='{:.1f}' width='{:.1f}' height='{:.1f}' fill='{}'/>",
                       kMargin + static_cast<double>(i) * step + 0.5, base - height,
                       std::max(0.5, step - 1.0), height, colour);
  }
  svg += line(kMargin, base, kMargin + room, base, "axis");
  svg += fmt::format("<text x='{}' y='{}' class='tick'>{:.4g}</text>", kMargin, base + 14.0, options.low);
  svg += fmt::format("<text x='{}' y='{}' class='tick' text-anchor='end'>{:.4g}</text>", kMargin + room,
                     base + 14.0, options.high);
  return svg + "</svg>";
}

}  // namespace opaline
