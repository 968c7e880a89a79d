#include "data/contact_sheet.h"

#include <fmt/format.h>

#include <algorithm>
#include <array>
#include <cctype>

#include "core/error.h"
#include "core/parallel.h"

namespace opaline {
namespace {

constexpr int kGap = 3;
constexpr int kTextHeight = 10;
constexpr int kLetter = 8;  // pixels from one letter to the next
constexpr int kDot = 2;     // pixels of a letter's dot
constexpr int kAcross = 2;  // scenes beside each other
constexpr uint8_t kPaper = 40;
constexpr uint8_t kInk = 215;

// Letters of 3 x 5 dots, row by row from the top, three bits a row.
constexpr std::array<uint16_t, 10> kDigits = {
    0b111101101101111, 0b010110010010111, 0b111001111100111, 0b111001011001111, 0b101101111001001,
    0b111100111001111, 0b111100111101111, 0b111001010010010, 0b111101111101111, 0b111101111001111};
constexpr std::array<uint16_t, 26> kLetters = {
    0b010101111101101, 0b110101110101110, 0b011100100100011, 0b110101101101110, 0b111100110100111,
    0b111100110100100, 0b011100101101011, 0b101101111101101, 0b111010010010111, 0b001001001101010,
    0b101101110101101, 0b100100100100111, 0b101111111101101, 0b110101101101101, 0b010101101101010,
    0b110101110100100, 0b010101101111011, 0b110101110101101, 0b011100010001110, 0b111010010010010,
    0b101101101101111, 0b101101101101010, 0b101101111111101, 0b101101010101101, 0b101101010010010,
    0b111001010100111};

uint16_t glyph(char c) {
  if (c >= '0' && c <= '9') return kDigits[static_cast<size_t>(c - '0')];
  if (c == '.') return 0b000000000000010;
  if (c == '-') return 0b000000111000000;
  const int upper = std::toupper(static_cast<unsigned char>(c));
  return upper >= 'A' && upper <= 'Z' ? kLetters[static_cast<size_t>(upper - 'A')] : uint16_t{0};
}

void paste(Picture& sheet, const Picture& picture, int x0, int y0) {
  for (int y = 0; y < picture.height && y0 + y < sheet.height; ++y) {
    const auto from = picture.rgb.begin() + std::ptrdiff_t{3} * y * picture.width;
    const int width = std::min(picture.width, sheet.width - x0);
    std::copy_n(from, std::ptrdiff_t{3} * width,
                sheet.rgb.begin() + std::ptrdiff_t{3} * ((y0 + y) * sheet.width + x0));
  }
}

struct SheetRow {
  std::string title;
  std::vector<SceneTile> tiles;
};

/// Two digits after the point, without the zero before it.
std::string share(float value) {
  const std::string text = fmt::format("{:.2f}", value);
  return text.starts_with("0.") ? text.substr(1) : text;
}

std::string parameters(const Scene& scene) {
  std::string text;
  if (scene.sigma_t) {
    const auto& s = *scene.sigma_t;
    text += fmt::format(" sigma {:.0f} {:.0f} {:.0f}", s[0], s[1], s[2]);
  }
  if (scene.albedo) {
    const auto& a = *scene.albedo;
    text += fmt::format(" a {} {} {}", share(a[0]), share(a[1]), share(a[2]));
  }
  if (scene.g) text += " g " + share(*scene.g);
  return text;
}

SheetRow read_row(const Dataset& dataset, const ScenePlace& place, int tile) {
  SheetRow row{.title = fmt::format("{} {}", to_string(place.split), dataset.id(place.split, place.index)),
               .tiles = {}};
  try {
    const Scene scene = dataset.load(place.split, place.index);
    row.title += parameters(scene);
    row.tiles = scene_tiles(scene);
    for (SceneTile& one : row.tiles) one.picture = scaled_to(one.picture, tile);
  } catch (const Error&) {
    row.title += " unreadable";
  }
  return row;
}

}  // namespace

std::vector<SceneTile> scene_tiles(const Scene& scene) {
  const auto map = [&](std::span<const float> values) {
    return MaskedMap{.values = values, .mask = scene.mask, .width = scene.width, .height = scene.height};
  };
  std::vector<SceneTile> tiles;
  tiles.push_back({"image", picture_of_input(scene)});
  if (!scene.bsdf.empty()) {
    Scene clear;
    clear.width = scene.width;
    clear.height = scene.height;
    clear.image = scene.bsdf;
    tiles.push_back({"bsdf", picture_of_input(clear)});
  }
  tiles.push_back({"DoP", picture_of_dop(scene)});
  tiles.push_back({"AoP", picture_of_aop(scene)});
  if (!scene.normal.empty()) tiles.push_back({"normal", picture_of_normals(map(scene.normal))});
  if (!scene.depth.empty()) {
    const ValueRange range = range_inside(map(scene.depth));
    tiles.push_back({"depth", picture_of_depth(map(scene.depth), range.low, range.high)});
  }
  return tiles;
}

std::vector<ScenePlace> spread_scenes(const Dataset& dataset, int64_t count) {
  const int64_t train = dataset.size(Split::kTrain);
  const int64_t all = train + dataset.size(Split::kTest);
  const int64_t n = std::clamp<int64_t>(count, 0, all);
  std::vector<ScenePlace> places;
  for (int64_t k = 0; k < n; ++k) {
    const int64_t at = n > 1 ? k * (all - 1) / (n - 1) : 0;
    places.push_back(at < train ? ScenePlace{Split::kTrain, at} : ScenePlace{Split::kTest, at - train});
  }
  return places;
}

Picture contact_sheet(const Dataset& dataset, const ContactSheetOptions& options) {
  const std::vector<ScenePlace> places = spread_scenes(dataset, options.scenes);
  std::vector<SheetRow> rows(places.size());
  parallel_for(static_cast<int64_t>(places.size()), [&](int64_t i) {
    rows[static_cast<size_t>(i)] = read_row(dataset, places[static_cast<size_t>(i)], options.tile);
  });
  const auto widest = std::max_element(rows.begin(), rows.end(), [](const SheetRow& a, const SheetRow& b) {
    return a.tiles.size() < b.tiles.size();
  });
  const int columns = widest == rows.end() ? 1 : std::max(1, static_cast<int>(widest->tiles.size()));
  int tile = 1;
  for (const SheetRow& row : rows) {
    for (const SceneTile& one : row.tiles) tile = std::max({tile, one.picture.width, one.picture.height});
  }

  const int across = rows.size() > 1 ? kAcross : 1;
  const int block_width = columns * (tile + kGap) + 2 * kGap;
  const int block_height = kTextHeight + tile + 3 * kGap;
  const int down = (static_cast<int>(rows.size()) + across - 1) / across;
  Picture sheet{.width = across * block_width + kGap,
                .height = kTextHeight + 4 * kGap + down * block_height,
                .rgb = {}};
  sheet.rgb.assign(size_t{3} * static_cast<size_t>(sheet.width) * static_cast<size_t>(sheet.height), kPaper);
  for (int side = 0; side < across && widest != rows.end(); ++side) {
    for (size_t c = 0; c < widest->tiles.size(); ++c) {
      draw_text(sheet, side * block_width + 2 * kGap + static_cast<int>(c) * (tile + kGap), 2 * kGap,
                widest->tiles[c].name);
    }
  }
  for (size_t i = 0; i < rows.size(); ++i) {
    const int x = static_cast<int>(i) % across * block_width + 2 * kGap;
    const int y = kTextHeight + 4 * kGap + static_cast<int>(i) / across * block_height;
    draw_text(sheet, x, y, rows[i].title);
    for (size_t c = 0; c < rows[i].tiles.size(); ++c) {
      paste(sheet, rows[i].tiles[c].picture, x + static_cast<int>(c) * (tile + kGap), y + kTextHeight + kGap);
    }
  }
  return sheet;
}

void draw_text(Picture& picture, int x, int y, std::string_view text) {
  for (const char c : text) {
    const unsigned bits = glyph(c);
    for (int dot = 0; dot < 15 * kDot * kDot; ++dot) {
      const int column = dot % (3 * kDot);
      const int row = dot / (3 * kDot);
      const int bit = 14 - (row / kDot * 3 + column / kDot);
      const int px = x + column;
      const int py = y + row;
      if ((bits >> bit & 1U) == 0 || px < 0 || py < 0 || px >= picture.width || py >= picture.height)
        continue;
      const auto at =
          3 * (static_cast<size_t>(py) * static_cast<size_t>(picture.width) + static_cast<size_t>(px));
      std::fill_n(picture.rgb.begin() + static_cast<std::ptrdiff_t>(at), 3, kInk);
    }
    x += kLetter;
  }
}

}  // namespace opaline
