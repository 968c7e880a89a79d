// Line charts and scatter plots as inline SVG.
#pragma once

#include <cstdint>
#include <optional>
#include <string>
#include <vector>

namespace opaline {

struct ChartPoint {
  double x = 0.0;
  double y = 0.0;
};

struct ChartSeries {
  std::string name;
  std::string colour;  ///< as CSS has it
  std::vector<ChartPoint> points;
  bool markers = false;  ///< a dot at each point
  bool line = true;      ///< false: dots alone, in a chart whose other series have lines
};

struct ChartOptions {
  std::string title = {};
  std::string x_label = {};
  bool log_x = false;                    ///< points that are not positive are left out
  bool log_y = false;                    ///< points that are not positive are left out
  bool lines = true;                     ///< false: a scatter plot, whatever the series say
  bool diagonal = false;                 ///< the line y = x, and one range for both axes
  std::vector<double> x_marks = {};      ///< dashed verticals, such as the change of stage
  std::optional<double> reference = {};  ///< dashed horizontal
  std::string reference_name = {};
  int width = 396;
  int height = 240;
};

/// One <svg> element. Points that are not finite are left out; without any point it says so.
std::string render_chart(const std::vector<ChartSeries>& series, const ChartOptions& options);

struct BarOptions {
  std::string title = {};
  double low = 0.0;  ///< values at the ends of the x axis
  double high = 1.0;
  int width = 252;
  int height = 150;
};

/// One <svg> element: a bar a bin of equal width, from 0.
std::string render_histogram(const std::vector<int64_t>& counts, const std::string& colour,
                             const BarOptions& options);

/// A file of its own: charts of `width` x `height`, `columns` in a row, on white, with the styles they use.
std::string chart_sheet(const std::vector<std::string>& charts, int columns, int width, int height);

/// Text with &, <, > and quotes escaped.
std::string escape_html(std::string_view text);

}  // namespace opaline
