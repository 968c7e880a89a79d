// The frame of our HTML pages: one self-contained file each, in one style.
#pragma once

#include <string>
#include <string_view>

#include "data/picture.h"

namespace opaline {

/// A whole document: head with the style, `body` inside of <main>. Both texts are HTML.
std::string html_page(std::string_view title, std::string_view body);
/// A titled box; empty where the body is.
std::string html_section(std::string_view title, std::string_view body);
/// An inline image with its caption, which is escaped.
std::string html_figure(const Picture& picture, std::string_view caption);

}  // namespace opaline
