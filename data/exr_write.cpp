// Writing EXR files.
#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfIO.h>
#include <ImfMultiPartOutputFile.h>
#include <ImfOutputFile.h>
#include <ImfOutputPart.h>
#include <ImfPartType.h>

#include <array>
#include <bit>
#include <cstring>
#include <exception>

#include "core/error.h"
#include "core/file.h"
#include "data/exr.h"
#include "data/exr_header.h"

namespace opaline {
namespace {

/// In the order of ExrCompression.
struct Codec {
  Imf::Compression imf;
  int lines;  ///< of a chunk
};
constexpr std::array<Codec, 5> kCompressions = {{{Imf::NO_COMPRESSION, 1},
                                                 {Imf::RLE_COMPRESSION, 1},
                                                 {Imf::ZIPS_COMPRESSION, 1},
                                                 {Imf::ZIP_COMPRESSION, 16},
                                                 {Imf::PIZ_COMPRESSION, 32}}};

class MemoryOutput final : public Imf::OStream {
 public:
  MemoryOutput() : Imf::OStream("memory") {}

  void write(const char from[], int count) override {
    const size_t end = position_ + static_cast<size_t>(count);
    if (end > bytes_.size()) bytes_.resize(end);
    std::memcpy(bytes_.data() + position_, from, static_cast<size_t>(count));
    position_ = end;
  }
  uint64_t tellp() override { return position_; }
  void seekp(uint64_t position) override { position_ = static_cast<size_t>(position); }
  std::vector<std::byte> take() { return std::move(bytes_); }

 private:
  std::vector<std::byte> bytes_;
  size_t position_ = 0;
};

Imf::Header make_header(const ExrImage& image, const ExrPart& part, bool multi_part) {
  const Window& w = part.window;
  const std::string where = fmt::format("write EXR part '{}'", part.name);
  const auto expected = static_cast<size_t>(w.pixels()) * part.channels.size();
  if (w.width() < 1 || w.height() < 1 || part.channels.empty()) {
    fail(where, "has window {} and {} channels", to_string(w), part.channels.size());
  }
  if (part.pixels.size() != expected) {
    fail(where, "has {} values, window {} with {} channels needs {}", part.pixels.size(), to_string(w),
         part.channels.size(), expected);
  }
  Imf::Header header(Imath::Box2i({0, 0}, {image.width - 1, image.height - 1}),
                     Imath::Box2i({w.x0, w.y0}, {w.x1 - 1, w.y1 - 1}), 1.0F, {0.0F, 0.0F}, 1.0F,
                     Imf::INCREASING_Y, kCompressions[static_cast<size_t>(image.compression)].imf);
  for (const std::string& channel : part.channels) {
    header.channels().insert(channel, Imf::Channel(part.half ? Imf::HALF : Imf::FLOAT));
  }
  if (multi_part || !part.name.empty()) header.setName(part.name);
  header.setType(Imf::SCANLINEIMAGE);
  return header;
}

/// Writes a part through `write(frame buffer, rows)`; half channels are converted first, as OpenEXR wants
/// buffers of the file's own type.
template <class Out>
void write_pixels(Out& out, const ExrPart& part) {
  const size_t count = part.channels.size();
  const Window& w = part.window;
  Imf::FrameBuffer buffer;
  if (part.half) {
    std::vector<Imath::half> halves(part.pixels.begin(), part.pixels.end());
    const auto pixel = static_cast<int64_t>(count * sizeof(Imath::half));
    const int64_t row = pixel * w.width();
    for (size_t c = 0; c < count; ++c) {
      const auto base =
          reinterpret_cast<uintptr_t>(halves.data() + c) - static_cast<uintptr_t>(w.x0 * pixel + w.y0 * row);
      buffer.insert(part.channels[c], Imf::Slice(Imf::HALF, reinterpret_cast<char*>(base),
                                                 static_cast<size_t>(pixel), static_cast<size_t>(row)));
    }
    out.setFrameBuffer(buffer);
    out.writePixels(w.height());
    return;
  }
  auto* values = const_cast<float*>(part.pixels.data());  // OpenEXR's slices are for reading and writing
  for (size_t c = 0; c < count; ++c) {
    buffer.insert(part.channels[c], exr_slice(Imf::FLOAT, values, w, count, c));
  }
  out.setFrameBuffer(buffer);
  out.writePixels(w.height());
}

}  // namespace

std::vector<std::byte> encode_exr(const ExrImage& image) {
  if (image.width < 1 || image.height < 1 || image.parts.empty()) {
    fail("write EXR", "image of {} x {} with {} parts", image.width, image.height, image.parts.size());
  }
  const bool multi_part = image.parts.size() > 1;
  std::vector<Imf::Header> headers;
  for (const ExrPart& part : image.parts) headers.push_back(make_header(image, part, multi_part));
  MemoryOutput stream;
  try {
    if (multi_part) {
      Imf::MultiPartOutputFile file(stream, headers.data(), static_cast<int>(headers.size()), false, 0);
      for (size_t i = 0; i < image.parts.size(); ++i) {
        Imf::OutputPart out(file, static_cast<int>(i));
        write_pixels(out, image.parts[i]);
      }
    } else {
      Imf::OutputFile out(stream, headers[0], 0);
      write_pixels(out, image.parts[0]);
    }
  } catch (const Error&) {
    throw;
  } catch (const std::exception& e) {
    fail("write EXR", "{}", e.what());
  }
  return stream.take();
}

void write_exr(const std::filesystem::path& path, const ExrImage& image) {
  write_file_atomically(path, encode_exr(image));
}

std::vector<std::vector<ExrChunk>> exr_chunks(std::span<const std::byte> bytes, const ExrImage& image) {
  const int lines = kCompressions[static_cast<size_t>(image.compression)].lines;
  size_t at = check_exr_headers(bytes, "encoded EXR");
  std::vector<std::vector<ExrChunk>> parts;
  for (const ExrPart& part : image.parts) {
    std::vector<ExrChunk>& chunks = parts.emplace_back();
    for (int y = part.window.y0; y < part.window.y1; y += lines, at += sizeof(uint64_t)) {
      if (bytes.size() - at < sizeof(uint64_t)) fail("encoded EXR", "ends inside its line tables");
      uint64_t offset = 0;
      for (unsigned i = 0; i < sizeof(offset); ++i)
        offset |= std::to_integer<uint64_t>(bytes[at + i]) << (8 * i);
      chunks.push_back({y, static_cast<int64_t>(offset)});
    }
  }
  return parts;
}

}  // namespace opaline
