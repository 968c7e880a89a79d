// A rectangle of pixels.
#pragma once

#include <algorithm>
#include <cstdint>
#include <string>

namespace opaline {

/// Pixels [x0, x1) x [y0, y1), y down.
struct Window {
  int x0 = 0;
  int y0 = 0;
  int x1 = 0;
  int y1 = 0;

  int width() const { return x1 - x0; }
  int height() const { return y1 - y0; }
  int64_t pixels() const { return int64_t{width()} * height(); }
  /// The place of a pixel in the window, row by row.
  size_t at(int x, int y) const { return static_cast<size_t>(int64_t{y - y0} * width() + (x - x0)); }
  bool contains(const Window& other) const {
    return x0 <= other.x0 && y0 <= other.y0 && x1 >= other.x1 && y1 >= other.y1;
  }
  bool operator==(const Window&) const = default;
};

/// "[x0, x1) x [y0, y1)".
std::string to_string(const Window& window);

/// `margin` pixels more on every side, as far as the image goes.
inline Window grown(const Window& window, int margin, int width, int height) {
  return {std::max(window.x0 - margin, 0), std::max(window.y0 - margin, 0),
          std::min(window.x1 + margin, width), std::min(window.y1 + margin, height)};
}

}  // namespace opaline
