#include "data/png.h"

#include <zlib.h>

#include "tests/data/support.h"

namespace opaline::test {
namespace {

/// A PNG put together by hand, so that it can be of any kind.
class PngBuilder {
 public:
  PngBuilder(uint32_t width, uint32_t height, char depth, char colour, char interlace = 0) {
    text_ = "\x89PNG\r\n\x1a\n";
    std::string head = u32(width) + u32(height);
    head += std::string{depth, colour, 0, 0, interlace};
    chunk("IHDR", head);
  }
  PngBuilder& chunk(const std::string& type, const std::string& data) {
    const std::string body = type + data;
    const uLong crc = crc32(0, reinterpret_cast<const Bytef*>(body.data()), static_cast<uInt>(body.size()));
    text_ += u32(static_cast<uint32_t>(data.size())) + body + u32(static_cast<uint32_t>(crc));
    return *this;
  }
  /// Rows with their leading filter bytes.
  std::vector<std::byte> finish(const std::string& rows) {
    uLongf size = compressBound(rows.size());
    std::string packed(size, '\0');
    compress(reinterpret_cast<Bytef*>(packed.data()), &size, reinterpret_cast<const Bytef*>(rows.data()),
             rows.size());
    packed.resize(size);
    chunk("IDAT", packed).chunk("IEND", "");
    const auto bytes = std::as_bytes(std::span(text_.data(), text_.size()));
    return {bytes.begin(), bytes.end()};
  }

 private:
  static std::string u32(uint32_t x) {
    return {static_cast<char>(x >> 24), static_cast<char>(x >> 16), static_cast<char>(x >> 8),
            static_cast<char>(x)};
  }
  std::string text_;
};

constexpr char kGrey = 0;
constexpr char kRgb = 2;
constexpr char kPalette = 3;
constexpr char kGreyAlpha = 4;
constexpr char kRgbAlpha = 6;

std::string bytes_of(std::initializer_list<int> values) {
  std::string text;
  for (const int value : values) text += static_cast<char>(value);
  return text;
}

std::vector<std::byte> rgb_file() {
  std::vector<uint8_t> pixels;
  for (int i = 0; i < 5 * 4 * 3; ++i) pixels.push_back(static_cast<uint8_t>(4 * i));
  return encode_png(5, 4, 3, pixels);
}

std::string refusal(const std::vector<std::byte>& bytes) {
  return message_of([&] { decode_png(bytes, "a.png"); });
}

TEST_CASE("8-bit PNG comes back exactly", "[png]") {
  const TempFolder folder;
  for (const int channels : {1, 3}) {
    std::vector<uint8_t> pixels;
    for (int i = 0; i < 7 * 5 * channels; ++i) pixels.push_back(static_cast<uint8_t>(37 * i));
    write_png(folder / "a.png", 7, 5, channels, pixels);
    const PngImage image = read_png(folder / "a.png");
    CHECK(image.width == 7);
    CHECK(image.height == 5);
    CHECK(image.channels == channels);
    CHECK(image.bits == 8);
    CHECK(image.samples == std::vector<uint16_t>(pixels.begin(), pixels.end()));
    CHECK(read_png_size(folder / "a.png") == PngSize{7, 5});
  }
}

TEST_CASE("other kinds of PNG are decoded rightly", "[png]") {
  SECTION("16 bits stay 16 bits") {
    const PngImage image =
        decode_png(PngBuilder(2, 1, 16, kGrey).finish(bytes_of({0, 0x12, 0x34, 0xff, 0xfe})), "a.png");
    CHECK(image.bits == 16);
    CHECK(image.samples == std::vector<uint16_t>{0x1234, 0xfffe});
  }
  SECTION("grey of one bit") {
    const PngImage image = decode_png(PngBuilder(4, 1, 1, kGrey).finish(bytes_of({0, 0b10100000})), "a.png");
    CHECK(image.bits == 8);
    CHECK(image.samples == std::vector<uint16_t>{255, 0, 255, 0});
  }
  SECTION("palette") {
    PngBuilder builder(2, 1, 8, kPalette);
    builder.chunk("PLTE", bytes_of({1, 2, 3, 40, 50, 60}));
    const PngImage image = decode_png(builder.finish(bytes_of({0, 1, 0})), "a.png");
    CHECK(image.channels == 3);
    CHECK(image.samples == std::vector<uint16_t>{40, 50, 60, 1, 2, 3});
  }
  SECTION("opaque alpha is dropped") {
    const PngImage image =
        decode_png(PngBuilder(1, 1, 8, kRgbAlpha).finish(bytes_of({0, 9, 8, 7, 255})), "a.png");
    CHECK(image.channels == 3);
    CHECK(image.samples == std::vector<uint16_t>{9, 8, 7});
    const PngImage grey =
        decode_png(PngBuilder(1, 1, 16, kGreyAlpha).finish(bytes_of({0, 1, 2, 255, 255})), "a.png");
    CHECK(grey.channels == 1);
    CHECK(grey.samples == std::vector<uint16_t>{0x0102});
  }
  SECTION("interlaced") {
    const PngImage image = decode_png(PngBuilder(1, 1, 8, kRgb, 1).finish(bytes_of({0, 9, 8, 7})), "a.png");
    CHECK(image.samples == std::vector<uint16_t>{9, 8, 7});
  }
}

TEST_CASE("PNG that cannot be taken as it is is refused", "[png]") {
  CHECK(contains(refusal(PngBuilder(1, 1, 8, kRgbAlpha).finish(bytes_of({0, 9, 8, 7, 128}))), "transparent"));
  PngBuilder transparent(2, 1, 8, kPalette);
  transparent.chunk("PLTE", bytes_of({1, 2, 3, 40, 50, 60})).chunk("tRNS", bytes_of({0}));
  CHECK(contains(refusal(transparent.finish(bytes_of({0, 0, 1}))), "transparent"));
  CHECK(contains(refusal({}), "is empty"));
  CHECK(contains(refusal(std::vector<std::byte>(100, std::byte{7})), "not a PNG"));
}

TEST_CASE("huge declared PNG sizes are refused before they are allocated", "[png]") {
  CHECK(contains(refusal(PngBuilder(0x7fffffff, 0x7fffffff, 8, kRgb).finish("")), "over the limit"));
  CHECK(contains(refusal(PngBuilder(16000, 16000, 8, kRgb).finish("")), "over the limit"));
  CHECK(contains(refusal(PngBuilder(8000, 8000, 8, kRgb).finish("")), "bytes only"));
  CHECK(contains(refusal(PngBuilder(0, 5, 8, kRgb).finish("")), "a.png"));
}

TEST_CASE("a PNG cut at any byte is refused", "[png]") {
  const std::vector<std::byte> bytes = rgb_file();
  for (size_t length = 0; length < bytes.size(); ++length) {
    const std::vector<std::byte> cut(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(length));
    REQUIRE(contains(refusal(cut), "a.png"));
  }
}

TEST_CASE("damaged PNG files are parsed or refused, never more", "[png][fuzz]") {
  const int refused = parse_mutations(
      rgb_file(), 10000, 23, [](std::span<const std::byte> mutated) { decode_png(mutated, "a.png"); });
  CHECK(refused > 5000);
}

}  // namespace
}  // namespace opaline::test
