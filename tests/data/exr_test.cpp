#include "data/exr.h"

#include <ImfChannelList.h>
#include <ImfDeepFrameBuffer.h>
#include <ImfDeepScanLineOutputFile.h>
#include <ImfHeader.h>
#include <ImfOutputFile.h>
#include <ImfPartType.h>
#include <ImfTiledOutputFile.h>

#include "tests/data/support.h"

namespace opaline::test {
namespace {

ExrImage two_parts(bool half) {
  ExrImage image{.width = 12, .height = 10, .parts = {}};
  image.parts.push_back(
      {.name = "first", .window = {0, 0, 12, 10}, .channels = {"S1.R", "S0.R"}, .half = half});
  image.parts.push_back({.name = "second", .window = {-2, 3, 5, 11}, .channels = {"depth.Z"}, .half = half});
  Random random(1, Purpose::kTest);
  for (ExrPart& part : image.parts) {
    part.pixels.resize(static_cast<size_t>(part.window.pixels()) * part.channels.size());
    for (float& value : part.pixels) value = static_cast<float>(random.uniform(-2, 2));
  }
  return image;
}

/// Overwrites the data window in the first header.
std::vector<std::byte> with_data_window(std::vector<std::byte> bytes, const std::array<int32_t, 4>& box) {
  const std::string key("dataWindow\0box2i\0", 17);
  std::string text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  const size_t at = text.find(key);
  REQUIRE(at != std::string::npos);
  std::memcpy(bytes.data() + at + key.size() + 4, box.data(), sizeof(box));
  return bytes;
}

std::string refusal(const std::vector<std::byte>& bytes) {
  return message_of([&] {
    const ExrReader reader(bytes, "some.exr");
    for (const ExrPartInfo& part : reader.parts()) reader.read(part.name);
  });
}

TEST_CASE("rows of a part, from pieces of a file", "[exr]") {
  ExrImage image = two_parts(false);
  for (const ExrCompression compression : {ExrCompression::kNone, ExrCompression::kRle, ExrCompression::kZips,
                                           ExrCompression::kZip, ExrCompression::kPiz}) {
    image.compression = compression;
    const std::vector<std::byte> bytes = encode_exr(image);
    const auto chunks = exr_chunks(bytes, image);
    REQUIRE(chunks.size() == 2);
    const int64_t head = chunks[0].front().offset;
    const int64_t second = chunks[1].front().offset;
    const std::span<const std::byte> all(bytes);
    const std::vector<ExrBytes> pieces = {{0, all.first(static_cast<size_t>(head))},
                                          {second, all.subspan(static_cast<size_t>(second))}};
    const ExrReader reader(pieces, static_cast<int64_t>(bytes.size()), "some.exr");
    const ExrPart rows = reader.read("second", image.parts[1].channels, ExrRows{5, 8});
    CHECK(rows.window == Window{-2, 5, 5, 8});
    CHECK(std::equal(rows.pixels.begin(), rows.pixels.end(), image.parts[1].pixels.begin() + 2 * 7));
    CHECK(contains(message_of([&] { reader.read("first"); }), "were not read"));
    CHECK(contains(message_of([&] {
                     reader.read("second", image.parts[1].channels, ExrRows{0, 3});
                   }),
                   "no rows"));
  }
  const std::vector<std::byte> bytes = encode_exr(image);
  const std::vector<ExrBytes> torn = {{0, std::span<const std::byte>(bytes).first(100)}};
  CHECK_THROWS_AS(ExrReader(torn, static_cast<int64_t>(bytes.size()), "some.exr"), Error);
}

TEST_CASE("float EXR comes back exactly, channels in the order asked for", "[exr]") {
  const ExrImage image = two_parts(false);
  const std::vector<std::byte> bytes = encode_exr(image);
  const ExrReader reader(bytes, "some.exr");
  CHECK(reader.width() == 12);
  CHECK(reader.height() == 10);
  REQUIRE(reader.parts().size() == 2);
  CHECK(reader.has_part("second"));
  CHECK_FALSE(reader.has_part("third"));
  // The parts may be read in any order, and more than once.
  for (const size_t i : {1U, 0U, 1U}) {
    const ExrPart& expected = image.parts[i];
    const ExrPart part = reader.read(expected.name, expected.channels);
    CHECK(part.window == expected.window);
    CHECK_FALSE(part.half);
    CHECK(part.pixels == expected.pixels);
  }
  const std::vector<std::string> swapped = {"S0.R", "S1.R"};
  const ExrPart part = reader.read("first", swapped);
  CHECK(part.pixels[0] == image.parts[0].pixels[1]);
  CHECK(part.pixels[1] == image.parts[0].pixels[0]);
}

TEST_CASE("half EXR is within half a unit in the last place", "[exr]") {
  const ExrImage image = two_parts(true);
  const std::vector<std::byte> bytes = encode_exr(image);
  const ExrReader reader(bytes, "some.exr");
  for (const ExrPart& expected : image.parts) {
    const ExrPart part = reader.read(expected.name, expected.channels);
    CHECK(part.half);
    for (size_t i = 0; i < expected.pixels.size(); ++i) {
      const double error =
          std::abs(static_cast<double>(part.pixels[i]) - static_cast<double>(expected.pixels[i]));
      REQUIRE(error <= std::max(std::abs(static_cast<double>(expected.pixels[i])) / 2048, 1e-7));
    }
  }
}

TEST_CASE("EXR files are written whole and read back from disk", "[exr]") {
  const TempFolder folder;
  ExrImage image = two_parts(true);
  image.parts.resize(1);
  image.parts[0].name = "";
  write_exr(folder / "a.exr", image);
  const std::vector<std::byte> bytes = read_file(folder / "a.exr");
  const ExrReader reader(bytes, "a.exr");
  CHECK(reader.parts().at(0).name.empty());
  CHECK(reader.read("").channels == std::vector<std::string>{"S0.R", "S1.R"});
}

TEST_CASE("missing EXR parts and channels are named with what there is", "[exr]") {
  const std::vector<std::byte> bytes = encode_exr(two_parts(true));
  const ExrReader reader(bytes, "some.exr");
  const std::string part = message_of([&] { reader.read("truth"); });
  CHECK(contains(part, "some.exr"));
  CHECK(contains(part, "no part 'truth'"));
  CHECK(contains(part, "first, second"));
  const std::vector<std::string> names = {"S0.R", "S2.B"};
  const std::string channel = message_of([&] { reader.read("first", names); });
  CHECK(contains(channel, "no channel 'S2.B'"));
  CHECK(contains(channel, "S0.R, S1.R"));
}

TEST_CASE("an EXR cut at any byte is refused", "[exr]") {
  const std::vector<std::byte> bytes = encode_exr(two_parts(true));
  for (size_t length = 0; length < bytes.size(); ++length) {
    const std::vector<std::byte> cut(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(length));
    REQUIRE(contains(refusal(cut), "some.exr"));
  }
}

TEST_CASE("EXR sizes over the limits are refused before they are allocated", "[exr]") {
  const std::vector<std::byte> bytes = encode_exr(two_parts(true));
  constexpr int32_t kMax = std::numeric_limits<int32_t>::max();
  CHECK_FALSE(refusal(with_data_window(bytes, {0, 0, 1 << 20, 1 << 20})).empty());
  CHECK_FALSE(refusal(with_data_window(bytes, {-kMax, -kMax, kMax, kMax})).empty());
  CHECK_FALSE(refusal(with_data_window(bytes, {5, 5, 2, 2})).empty());
  CHECK_FALSE(refusal(with_data_window(bytes, {kMax - 5, 0, kMax, 9})).empty());
  const std::string message = message_of([&] { const ExrReader reader(bytes, "a.exr", {.max_side = 8}); });
  CHECK(contains(message, "12 x 10"));
  const std::string values = message_of([&] { const ExrReader reader(bytes, "a.exr", {.max_values = 200}); });
  CHECK(contains(values, "over the limit of 200 values"));
}

TEST_CASE("an EXR whose sizes lie is refused before OpenEXR trusts them", "[exr]") {
  ExrImage image = two_parts(true);
  image.parts.resize(1);
  image.parts[0].name = "";
  const std::vector<std::byte> bytes = encode_exr(image);
  const std::string text(reinterpret_cast<const char*>(bytes.data()), bytes.size());
  const auto refusal_at = [&](const std::string& key, size_t offset, uint8_t value) {
    std::vector<std::byte> changed = bytes;
    const size_t at = text.find(key);
    REQUIRE(at != std::string::npos);
    changed[at + key.size() + offset] = static_cast<std::byte>(value);
    return refusal(changed);
  };
  const std::string channels("channels\0chlist\0", 16);
  CHECK(contains(refusal_at(channels, 0, 20), "attribute 'channels'"));
  CHECK(contains(refusal_at(channels, 3, 0x7f), "ends inside attribute 'channels'"));
  CHECK(contains(refusal_at(std::string("lineOrder\0lineOrder\0", 20), 0, 2), "attribute 'lineOrder'"));
  // 16,384 x 16 pixels are within the limits, but not within one chunk of a file of this size.
  CHECK(contains(message_of([&] {
                   const ExrReader reader(with_data_window(bytes, {0, 0, 16383, 15}), "some.exr");
                 }),
                 "bytes only"));
}

TEST_CASE("deep, tiled and subsampled EXR is refused by name", "[exr]") {
  const TempFolder folder;
  const std::string path = (folder / "odd.exr").string();
  std::vector<float> values(64, 0.5F);
  const auto slice = [&](int sampling) {
    return Imf::Slice(Imf::FLOAT, reinterpret_cast<char*>(values.data()), sizeof(float), 8 * sizeof(float),
                      sampling, sampling);
  };
  SECTION("tiled") {
    Imf::Header header(8, 8);
    header.channels().insert("R", Imf::Channel(Imf::FLOAT));
    header.setTileDescription({4, 4, Imf::ONE_LEVEL});
    {
      Imf::TiledOutputFile file(path.c_str(), header);
      Imf::FrameBuffer buffer;
      buffer.insert("R", slice(1));
      file.setFrameBuffer(buffer);
      file.writeTiles(0, 1, 0, 1);
    }
    CHECK(contains(refusal(read_file(path)), "tiles"));
  }
  SECTION("subsampled") {
    Imf::Header header(8, 8);
    header.channels().insert("BY", Imf::Channel(Imf::FLOAT, 2, 2));
    {
      Imf::OutputFile file(path.c_str(), header);
      Imf::FrameBuffer buffer;
      buffer.insert("BY", slice(2));
      file.setFrameBuffer(buffer);
      file.writePixels(8);
    }
    CHECK(contains(refusal(read_file(path)), "channel 'BY' subsampled by 2 x 2"));
  }
  SECTION("deep") {
    Imf::Header header(8, 8);
    header.channels().insert("R", Imf::Channel(Imf::FLOAT));
    header.setType(Imf::DEEPSCANLINE);
    header.compression() = Imf::ZIPS_COMPRESSION;
    {
      Imf::DeepScanLineOutputFile file(path.c_str(), header);
      std::vector<unsigned> counts(64, 1);
      std::vector<float*> samples;
      for (float& value : values) samples.push_back(&value);
      Imf::DeepFrameBuffer buffer;
      buffer.insertSampleCountSlice(Imf::Slice(Imf::UINT, reinterpret_cast<char*>(counts.data()),
                                               sizeof(unsigned), 8 * sizeof(unsigned)));
      buffer.insert("R", Imf::DeepSlice(Imf::FLOAT, reinterpret_cast<char*>(samples.data()), sizeof(float*),
                                        8 * sizeof(float*), sizeof(float)));
      file.setFrameBuffer(buffer);
      file.writePixels(8);
    }
    CHECK(contains(refusal(read_file(path)), "deep"));
  }
}

TEST_CASE("damaged EXR files are parsed or refused, never more", "[exr][fuzz]") {
  const std::vector<std::byte> bytes = encode_exr(two_parts(true));
  const int refused = parse_mutations(bytes, 3000, 21, [](std::span<const std::byte> mutated) {
    const ExrReader reader(mutated, "some.exr");
    for (const ExrPartInfo& part : reader.parts()) reader.read(part.name);
  });
  CHECK(refused > 1000);
}

TEST_CASE("writing an EXR checks its parts", "[exr]") {
  ExrImage image = two_parts(true);
  image.parts[1].pixels.pop_back();
  CHECK(contains(message_of([&] { encode_exr(image); }), "part 'second'"));
}

}  // namespace
}  // namespace opaline::test
