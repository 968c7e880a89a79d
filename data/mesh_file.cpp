#include "data/mesh_file.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <vector>

#include "core/error.h"
#include "core/file.h"

namespace opaline {
namespace {

using render::Surface;

/// Cuts the next word off the text; "" at its end.
std::string_view next_word(std::string_view& text) {
  constexpr std::string_view kSpace = " \t\r\n\v\f";
  const size_t begin = std::min(text.find_first_not_of(kSpace), text.size());
  text.remove_prefix(begin);
  const size_t end = std::min(text.find_first_of(kSpace), text.size());
  const std::string_view word = text.substr(0, end);
  text.remove_prefix(end);
  return word;
}

/// A finite number that single precision can hold the square of.
bool read_number(std::string_view word, double& value) {
  if (word.starts_with('+')) word.remove_prefix(1);
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  return error == std::errc{} && end == word.data() + word.size() && std::abs(value) < 1e18;
}

bool read_integer(std::string_view word, int64_t& value) {
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  return error == std::errc{} && end == word.data() + word.size();
}

void add_polygon(Surface& surface, std::span<const uint32_t> corners, const std::string& where,
                 const MeshLimits& limits) {
  if (corners.size() < 3) fail(where, "a face of {} corners", corners.size());
  if (static_cast<int64_t>(surface.triangles.size() + corners.size()) > limits.max_triangles) {
    fail(where, "more than {} triangles", limits.max_triangles);
  }
  for (size_t i = 2; i < corners.size(); ++i)
    surface.triangles.push_back({corners[0], corners[i - 1], corners[i]});
}

// --- OBJ

class ObjParser {
 public:
  ObjParser(std::string_view text, const std::string& file, const MeshLimits& limits)
      : text_(text), file_(file), limits_(limits) {
    surface_.curved = false;
  }

  Surface parse() {
    while (!text_.empty()) statement(next_line());
    return std::move(surface_);
  }

 private:
  std::string where() const { return fmt::format("{}:{}", file_, line_); }

  /// A line, with those that follow a backslash at its end.
  std::string_view next_line() {
    line_ += lines_;
    lines_ = 1;
    size_t end = text_.find('\n');
    joined_.clear();
    while (end != std::string_view::npos && continues(text_.substr(0, end))) {
      joined_.append(text_.substr(0, text_.rfind('\\', end))).push_back(' ');
      text_.remove_prefix(end + 1);
      end = text_.find('\n');
      ++lines_;
    }
    std::string_view line = text_.substr(0, end);
    text_.remove_prefix(std::min(line.size() + 1, text_.size()));
    if (joined_.empty()) return line;
    joined_.append(line);
    return joined_;
  }
  static bool continues(std::string_view line) {
    if (line.ends_with('\r')) line.remove_suffix(1);
    return line.ends_with('\\');
  }

  void statement(std::string_view line) {
    static constexpr std::array<std::string_view, 34> kIgnored = {
        "vt",         "vn",        "vp",    "g",     "o",      "s",     "mg",       "usemtl",   "mtllib",
        "usemap",     "maplib",    "p",     "l",     "curv",   "curv2", "surf",     "parm",     "trim",
        "hole",       "scrv",      "sp",    "end",   "con",    "bevel", "c_interp", "d_interp", "lod",
        "shadow_obj", "trace_obj", "ctech", "stech", "cstype", "deg",   "bmat"};
    const std::string_view word = next_word(line);
    if (word.empty() || word.starts_with('#')) return;
    if (word == "v") {
      vertex(line);
    } else if (word == "f") {
      face(line);
    } else if (std::find(kIgnored.begin(), kIgnored.end(), word) == kIgnored.end()) {
      fail(where(), "\"{}\" is no statement of an OBJ file", word.substr(0, 40));
    }
  }

  void vertex(std::string_view line) {
    if (static_cast<int64_t>(surface_.points.size()) >= limits_.max_vertices) {
      fail(where(), "more than {} vertices", limits_.max_vertices);
    }
    std::array<double, 3> p{};
    for (double& value : p) {
      const std::string_view word = next_word(line);
      if (!read_number(word, value)) fail(where(), "\"{}\" is no coordinate", word.substr(0, 40));
    }
    surface_.points.push_back({p[0], p[1], p[2]});
  }

  void face(std::string_view line) {
    corners_.clear();
    for (std::string_view word = next_word(line); !word.empty() && !word.starts_with('#');
         word = next_word(line)) {
      int64_t index = 0;
      const auto count = static_cast<int64_t>(surface_.points.size());
      if (!read_integer(word.substr(0, word.find('/')), index)) {
        fail(where(), "\"{}\" is no corner of a face", word.substr(0, 40));
      }
      const int64_t at = index < 0 ? count + index : index - 1;
      if (at < 0 || at >= count) fail(where(), "a face uses vertex {}; there are {} so far", index, count);
      corners_.push_back(static_cast<uint32_t>(at));
    }
    add_polygon(surface_, corners_, where(), limits_);
  }

  std::string_view text_;
  const std::string& file_;
  const MeshLimits& limits_;
  int64_t line_ = 0, lines_ = 1;
  std::string joined_;
  std::vector<uint32_t> corners_;
  Surface surface_;
};

// --- PLY

enum class Type { kInt8, kUint8, kInt16, kUint16, kInt32, kUint32, kFloat, kDouble };

struct TypeName {
  std::string_view name;
  Type type;
  size_t bytes;
};
constexpr std::array<TypeName, 16> kTypes = {{{"char", Type::kInt8, 1},
                                              {"uchar", Type::kUint8, 1},
                                              {"short", Type::kInt16, 2},
                                              {"ushort", Type::kUint16, 2},
                                              {"int", Type::kInt32, 4},
                                              {"uint", Type::kUint32, 4},
                                              {"float", Type::kFloat, 4},
                                              {"double", Type::kDouble, 8},
                                              {"int8", Type::kInt8, 1},
                                              {"uint8", Type::kUint8, 1},
                                              {"int16", Type::kInt16, 2},
                                              {"uint16", Type::kUint16, 2},
                                              {"int32", Type::kInt32, 4},
                                              {"uint32", Type::kUint32, 4},
                                              {"float32", Type::kFloat, 4},
                                              {"float64", Type::kDouble, 8}}};

struct Property {
  std::string name;
  TypeName type;
  bool list = false;
  TypeName count{};  // of a list
};

struct Element {
  std::string name;
  int64_t count = 0;
  std::vector<Property> properties;
};

class PlyParser {
 public:
  PlyParser(std::span<const std::byte> bytes, const std::string& file, const MeshLimits& limits)
      : text_(reinterpret_cast<const char*>(bytes.data()), bytes.size()), file_(file), limits_(limits) {
    surface_.curved = false;
  }

  Surface parse() {
    header();
    for (const Element& element : elements_) {
      if (element.count > 0 && element.properties.empty()) {
        fail(file_, "{} elements \"{}\" without a property", element.count, element.name);
      }
      // Each value takes a byte at least.
      if (element.count > static_cast<int64_t>(text_.size())) {
        fail(file_, "declares {} elements \"{}\" in {} bytes", element.count, element.name, text_.size());
      }
      if (element.name == "vertex") {
        vertices(element);
      } else if (element.name == "face") {
        faces(element);
      } else {
        for (row_ = 0; row_ < element.count; ++row_)
          for (const Property& property : element.properties) skip(property);
      }
    }
    return std::move(surface_);
  }

 private:
  enum class Format { kNone, kAscii, kLittle, kBig };

  std::string_view header_line() {
    const size_t end = text_.find('\n');
    if (end == std::string_view::npos || end > 4096) fail(file_, "its header has no end");
    std::string_view line = text_.substr(0, end);
    text_.remove_prefix(end + 1);
    if (line.ends_with('\r')) line.remove_suffix(1);
    return line;
  }

  const TypeName& type_of(std::string_view name) const {
    for (const TypeName& type : kTypes)
      if (type.name == name) return type;
    fail(file_, "\"{}\" in its header is no type", name.substr(0, 40));
  }

  void header() {
    if (header_line() != "ply") fail(file_, "does not begin with \"ply\"");
    for (;;) {
      std::string_view line = header_line();
      const std::string_view word = next_word(line);
      if (word == "end_header") break;
      if (word == "comment" || word == "obj_info" || word.empty()) continue;
      if (word == "format") {
        const std::string_view name = next_word(line);
        if (name == "ascii") format_ = Format::kAscii;
        if (name == "binary_little_endian") format_ = Format::kLittle;
        if (name == "binary_big_endian") format_ = Format::kBig;
      } else if (word == "element") {
        Element element{.name = std::string(next_word(line)), .count = 0, .properties = {}};
        if (!read_integer(next_word(line), element.count) || element.count < 0 || elements_.size() >= 64) {
          fail(file_, "its header declares no number of elements \"{}\"", element.name.substr(0, 40));
        }
        elements_.push_back(std::move(element));
      } else if (word == "property") {
        if (elements_.empty() || elements_.back().properties.size() >= 256) {
          fail(file_, "its header has a property without an element, or too many");
        }
        Property property;
        std::string_view type = next_word(line);
        property.list = type == "list";
        if (property.list) {
          property.count = type_of(next_word(line));
          type = next_word(line);
        }
        property.type = type_of(type);
        property.name = std::string(next_word(line));
        elements_.back().properties.push_back(std::move(property));
      } else {
        fail(file_, "\"{}\" in its header is no statement of a PLY file", word.substr(0, 40));
      }
    }
    if (format_ == Format::kNone) fail(file_, "its header names no known format");
  }

  [[noreturn]] void ends_early() const { fail(file_, "ends early, in element {}", row_); }

  double value(const TypeName& type) {
    if (format_ == Format::kAscii) {
      const std::string_view word = next_word(text_);
      if (word.empty()) ends_early();
      double result = 0.0;
      if (!read_number(word, result)) {
        fail(file_, "\"{}\" in element {} is no number", word.substr(0, 40), row_);
      }
      return result;
    }
    if (text_.size() < type.bytes) ends_early();
    std::array<char, 8> bytes{};
    std::memcpy(bytes.data(), text_.data(), type.bytes);
    text_.remove_prefix(type.bytes);
    if ((format_ == Format::kBig) == (std::endian::native == std::endian::little)) {
      std::reverse(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(type.bytes));
    }
    const auto as = [&bytes]<class T>(T result) {
      std::memcpy(&result, bytes.data(), sizeof(T));
      return static_cast<double>(result);
    };
    switch (type.type) {
      case Type::kInt8:
        return as(int8_t{});
      case Type::kUint8:
        return as(uint8_t{});
      case Type::kInt16:
        return as(int16_t{});
      case Type::kUint16:
        return as(uint16_t{});
      case Type::kInt32:
        return as(int32_t{});
      case Type::kUint32:
        return as(uint32_t{});
      case Type::kFloat:
        return as(float{});
      case Type::kDouble:
        break;
    }
    return as(double{});
  }

  int64_t length(const Property& property) {
    const double count = value(property.count);
    if (!(count >= 0.0 && count == std::floor(count) && count <= static_cast<double>(text_.size()))) {
      fail(file_, "a list of {} values in element {}", count, row_);
    }
    return static_cast<int64_t>(count);
  }

  void skip(const Property& property) {
    const int64_t count = property.list ? length(property) : 1;
    for (int64_t i = 0; i < count; ++i) value(property.type);
  }

  void vertices(const Element& element) {
    if (!surface_.points.empty()) fail(file_, "has two elements \"vertex\"");
    if (element.count > limits_.max_vertices) {
      fail(file_, "declares {} vertices; at most {} are read", element.count, limits_.max_vertices);
    }
    std::array<size_t, 3> places{};
    for (size_t axis = 0; axis < 3; ++axis) {
      const std::string_view name = std::string_view("xyz").substr(axis, 1);
      const auto found = std::find_if(element.properties.begin(), element.properties.end(),
                                      [&](const Property& p) { return p.name == name && !p.list; });
      if (found == element.properties.end()) fail(file_, "its vertices have no {}", name);
      places[axis] = static_cast<size_t>(found - element.properties.begin());
    }
    surface_.points.reserve(static_cast<size_t>(element.count));
    for (row_ = 0; row_ < element.count; ++row_) {
      std::array<double, 3> p{};
      for (size_t i = 0; i < element.properties.size(); ++i) {
        const Property& property = element.properties[i];
        const auto axis = std::find(places.begin(), places.end(), i) - places.begin();
        if (axis == 3) {
          skip(property);
          continue;
        }
        const double coordinate = value(property.type);
        if (!(std::abs(coordinate) < 1e18)) fail(file_, "vertex {} has the coordinate {}", row_, coordinate);
        p[static_cast<size_t>(axis)] = coordinate;
      }
      surface_.points.push_back({p[0], p[1], p[2]});
    }
  }

  void faces(const Element& element) {
    if (element.count > limits_.max_triangles) {
      fail(file_, "declares {} faces; at most {} are read", element.count, limits_.max_triangles);
    }
    const auto is_corners = [](const Property& p) {
      return p.list && (p.name == "vertex_indices" || p.name == "vertex_index");
    };
    if (std::none_of(element.properties.begin(), element.properties.end(), is_corners)) {
      fail(file_, "its faces have no list vertex_indices");
    }
    std::vector<uint32_t> corners;
    for (row_ = 0; row_ < element.count; ++row_) {
      for (const Property& property : element.properties) {
        if (!is_corners(property)) {
          skip(property);
          continue;
        }
        corners.clear();
        const int64_t count = length(property);
        for (int64_t i = 0; i < count; ++i) {
          const double index = value(property.type);
          if (!(index >= 0.0 && index < static_cast<double>(surface_.points.size()) &&
                index == std::floor(index))) {
            fail(file_, "face {} uses vertex {} of {}", row_, index, surface_.points.size());
          }
          corners.push_back(static_cast<uint32_t>(index));
        }
        add_polygon(surface_, corners, fmt::format("{}: face {}", file_, row_), limits_);
      }
    }
  }

  std::string_view text_;  // what is left
  const std::string& file_;
  const MeshLimits& limits_;
  Format format_ = Format::kNone;
  std::vector<Element> elements_;
  int64_t row_ = 0;
  Surface surface_;
};

std::string lower_extension(const std::filesystem::path& path) {
  std::string end = path.extension().string();
  std::transform(end.begin(), end.end(), end.begin(),
                 [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c - 'A' + 'a') : c; });
  return end;
}

}  // namespace

Surface decode_obj(std::string_view text, const std::string& file, const MeshLimits& limits) {
  return ObjParser(text, file, limits).parse();
}

Surface decode_ply(std::span<const std::byte> bytes, const std::string& file, const MeshLimits& limits) {
  return PlyParser(bytes, file, limits).parse();
}

bool is_mesh_file(const std::filesystem::path& path) {
  const std::string end = lower_extension(path);
  return end == ".obj" || end == ".ply";
}

Surface read_mesh(const std::filesystem::path& path, const MeshLimits& limits) {
  const std::vector<std::byte> bytes = read_file(path, int64_t{1} << 31);
  if (lower_extension(path) == ".ply") return decode_ply(bytes, path.string(), limits);
  return decode_obj({reinterpret_cast<const char*>(bytes.data()), bytes.size()}, path.string(), limits);
}

}  // namespace opaline
