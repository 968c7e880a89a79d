#include "data/exr.h"

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfIO.h>
#include <ImfInputPart.h>
#include <ImfMultiPartInputFile.h>
#include <ImfMultiPartOutputFile.h>
#include <ImfOutputFile.h>
#include <ImfOutputPart.h>
#include <ImfPartType.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <exception>
#include <limits>
#include <optional>

#include "core/error.h"
#include "core/file.h"

namespace opaline {
namespace {

/// OpenEXR reads from here; every access is checked against the end.
class MemoryInput final : public Imf::IStream {
 public:
  MemoryInput(std::span<const std::byte> bytes, const std::string& file)
      : Imf::IStream(file.c_str()), bytes_(bytes) {}

  bool read(char to[], int count) override {
    if (count < 0 || static_cast<uint64_t>(count) > bytes_.size() - position_) {
      throw Error("the file ends early");
    }
    std::memcpy(to, bytes_.data() + position_, static_cast<size_t>(count));
    position_ += static_cast<size_t>(count);
    return position_ < bytes_.size();
  }
  uint64_t tellg() override { return position_; }
  void seekg(uint64_t position) override {
    if (position > bytes_.size()) throw Error("the file ends early");
    position_ = static_cast<size_t>(position);
  }

 private:
  std::span<const std::byte> bytes_;
  size_t position_ = 0;
};

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

/// Bytes of the attribute types whose size the format fixes.
struct FixedSize {
  std::string_view type;
  uint32_t bytes;
};
constexpr std::array<FixedSize, 24> kFixedSizes = {{{"box2f", 16},
                                                    {"box2i", 16},
                                                    {"chromaticities", 32},
                                                    {"compression", 1},
                                                    {"deepImageState", 1},
                                                    {"double", 8},
                                                    {"envmap", 1},
                                                    {"float", 4},
                                                    {"int", 4},
                                                    {"keycode", 28},
                                                    {"lineOrder", 1},
                                                    {"m33d", 72},
                                                    {"m33f", 36},
                                                    {"m44d", 128},
                                                    {"m44f", 64},
                                                    {"rational", 8},
                                                    {"tiledesc", 9},
                                                    {"timecode", 8},
                                                    {"v2d", 16},
                                                    {"v2f", 8},
                                                    {"v2i", 8},
                                                    {"v3d", 24},
                                                    {"v3f", 12},
                                                    {"v3i", 12}}};

/// Walks the headers before OpenEXR sees them. It trusts what it reads: a size field may make it allocate
/// gigabytes, and a value longer than its size shifts all that follows. So every size must lie inside the
/// file and be that of its type, and kinds of data that we do not read are refused by name.
class HeaderWalk {
 public:
  HeaderWalk(std::span<const std::byte> bytes, const std::string& file) : bytes_(bytes), file_(file) {}

  void run() {
    constexpr uint32_t kMagic = 20000630;
    if (bytes_.size() < 8) fail(file_, "has {} bytes: not an EXR file", bytes_.size());
    if (u32() != kMagic) fail(file_, "is not an EXR file (wrong first four bytes)");
    const uint32_t version = u32();
    if ((version & 0xffU) != 2) fail(file_, "has EXR version {}, 2 is expected", version & 0xffU);
    if ((version & 0x200U) != 0) fail(file_, "has tiles; scan lines are expected");
    const bool multi_part = (version & 0x1000U) != 0;
    if (!multi_part && (version & 0x800U) != 0) fail(file_, "has deep data; flat scan lines are expected");
    constexpr int kMaxParts = 256;
    for (int part = 0; part < kMaxParts; ++part) {
      if (multi_part && at_end_mark()) return;
      header();
      if (!multi_part) return;
    }
    fail(file_, "declares over {} parts", kMaxParts);
  }

 private:
  uint32_t u32() {
    if (bytes_.size() - position_ < 4) fail(file_, "ends inside its header");
    uint32_t value = 0;
    for (unsigned i = 0; i < 4; ++i) value |= std::to_integer<uint32_t>(bytes_[position_ + i]) << (8 * i);
    position_ += 4;
    return value;
  }

  /// A name up to its terminating zero.
  std::string name() {
    std::string text;
    while (true) {
      if (position_ >= bytes_.size()) fail(file_, "ends inside its header");
      const char c = static_cast<char>(bytes_[position_++]);
      if (c == '\0') return text;
      text.push_back(c);
      if (text.size() > 255) fail(file_, "has a name of over 255 characters in its header");
    }
  }

  bool at_end_mark() {
    if (position_ >= bytes_.size()) fail(file_, "ends inside its header");
    return bytes_[position_] == std::byte{0};
  }

  void header() {
    std::string part_name;
    std::string type;
    while (!at_end_mark()) {
      const std::string attribute = name();
      const std::string kind = name();
      const uint32_t size = u32();
      if (size > bytes_.size() - position_) {
        fail(file_, "ends inside attribute '{}' ({} bytes declared, {} left)", attribute, size,
             bytes_.size() - position_);
      }
      check_value(attribute, kind, size);
      const std::string value(reinterpret_cast<const char*>(bytes_.data()) + position_, size);
      if (attribute == "name") part_name = value;
      if (attribute == "type") type = value;
      position_ += size;
    }
    ++position_;
    if (!type.empty() && type != Imf::SCANLINEIMAGE) {
      fail(file_, "part '{}' is of type '{}'; '{}' is expected", part_name, type, Imf::SCANLINEIMAGE);
    }
  }

  /// The value at the current position has the size that its type asks for.
  void check_value(const std::string& attribute, const std::string& kind, uint32_t size) {
    bool right = kind != "idmanifest";  // sized by its contents, and of deep images only
    for (const FixedSize& fixed : kFixedSizes) {
      if (kind == fixed.type) right = size == fixed.bytes;
    }
    const size_t begin = position_;
    if (kind == "chlist") {
      constexpr size_t kChannelBytes = 16;  // pixel type, linearity, two samplings
      while (!at_end_mark()) {
        name();
        position_ += kChannelBytes;
      }
      right = position_ + 1 - begin == size;
    }
    if (kind == "preview") {
      constexpr uint32_t kHead = 8;  // width and height, then four bytes a pixel
      const uint64_t pixels = size < kHead ? 0 : uint64_t{u32()} * u32();
      right = size >= kHead && pixels == (size - kHead) / 4 && (size - kHead) % 4 == 0;
    }
    position_ = begin;
    if (!right)
      fail(file_, "has a damaged header: attribute '{}' of type '{}' has {} bytes", attribute, kind, size);
  }

  std::span<const std::byte> bytes_;
  const std::string& file_;
  size_t position_ = 0;
};

std::string part_name(const Imf::Header& header) {
  return header.hasName() ? header.name() : std::string();
}

/// Bytes from the start of `values` to the value of pixel (0, 0), which may lie outside of it.
Imf::Slice slice(Imf::PixelType type, float* values, const Window& window, size_t channels, size_t channel) {
  const auto pixel_stride = static_cast<int64_t>(channels * sizeof(float));
  const int64_t row_stride = pixel_stride * window.width();
  const int64_t offset = window.x0 * pixel_stride + window.y0 * row_stride;
  // Integer arithmetic: the address of pixel (0, 0) need not be inside the array.
  const auto base = reinterpret_cast<uintptr_t>(values + channel) - static_cast<uintptr_t>(offset);
  return {type, reinterpret_cast<char*>(base), static_cast<size_t>(pixel_stride),
          static_cast<size_t>(row_stride)};
}

/// Bytes that one byte of a file can stand for: deflate ends at 1032 to 1, run lengths at 64; the wavelet and
/// cosine codecs are taken to stay under a generous bound of their own.
int64_t max_ratio(Imf::Compression compression) {
  switch (compression) {
    case Imf::NO_COMPRESSION:
      return 1;
    case Imf::RLE_COMPRESSION:
      return 64;
    case Imf::ZIPS_COMPRESSION:
    case Imf::ZIP_COMPRESSION:
      return 1032;
    default:
      return 65536;
  }
}

/// Size limits and what we do not read, checked on a parsed header. Fills what the part declares.
ExrPartInfo check_header(const std::string& file, size_t file_bytes, const Imf::Header& header,
                         const ExrLimits& limits) {
  ExrPartInfo info;
  info.name = part_name(header);
  const Imath::Box2i box = header.dataWindow();
  const auto side = [](int low, int high) { return int64_t{high} - low + 1; };
  const int64_t width = side(box.min.x, box.max.x);
  const int64_t height = side(box.min.y, box.max.y);
  if (width < 1 || height < 1 || width > limits.max_side || height > limits.max_side) {
    fail(file, "part '{}' declares {} x {} pixels; sides from 1 to {} are read", info.name, width, height,
         limits.max_side);
  }
  constexpr int kFarAway = 1 << 24;
  if (std::abs(int64_t{box.min.x}) > kFarAway || std::abs(int64_t{box.min.y}) > kFarAway) {
    fail(file, "part '{}' has its data window at ({}, {}), too far from the image", info.name, box.min.x,
         box.min.y);
  }
  info.window = {box.min.x, box.min.y, box.max.x + 1, box.max.y + 1};
  const Imf::ChannelList& channels = header.channels();
  for (auto channel = channels.begin(); channel != channels.end(); ++channel) {
    if (channel.channel().xSampling != 1 || channel.channel().ySampling != 1) {
      fail(file, "part '{}' has channel '{}' subsampled by {} x {}; full resolution is expected", info.name,
           channel.name(), channel.channel().xSampling, channel.channel().ySampling);
    }
    info.channels.emplace_back(channel.name());
  }
  const auto count = static_cast<int64_t>(info.channels.size());
  if (count == 0) fail(file, "part '{}' has no channels", info.name);
  if (width * height > limits.max_values / count) {
    fail(file, "part '{}' declares {} x {} pixels of {} channels, over the limit of {} values", info.name,
         width, height, count, limits.max_values);
  }
  const auto held = static_cast<int64_t>(file_bytes) * max_ratio(header.compression());
  if (width * height * count * static_cast<int64_t>(sizeof(Imath::half)) > held) {
    fail(file, "part '{}' declares {} x {} pixels of {} channels, but the file has {} bytes only", info.name,
         width, height, count, file_bytes);
  }
  return info;
}

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
                     Imf::INCREASING_Y, Imf::ZIP_COMPRESSION);
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
    buffer.insert(part.channels[c], slice(Imf::FLOAT, values, w, count, c));
  }
  out.setFrameBuffer(buffer);
  out.writePixels(w.height());
}

}  // namespace

std::string to_string(const Window& window) {
  return fmt::format("[{}, {}) x [{}, {})", window.x0, window.x1, window.y0, window.y1);
}

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

struct ExrReader::Impl {
  std::string file;
  std::unique_ptr<MemoryInput> stream;
  std::unique_ptr<Imf::MultiPartInputFile> input;
  std::vector<ExrPartInfo> parts;
  int width = 0;
  int height = 0;
};

ExrReader::ExrReader(std::span<const std::byte> bytes, std::string file, const ExrLimits& limits)
    : impl_(std::make_unique<Impl>()) {
  impl_->file = std::move(file);
  HeaderWalk(bytes, impl_->file).run();
  try {
    // OpenEXR's own cap: it sizes its line tables from the data window while it reads the header.
    Imf::Header::setMaxImageSize(ExrLimits().max_side, ExrLimits().max_side);
    impl_->stream = std::make_unique<MemoryInput>(bytes, impl_->file);
    impl_->input = std::make_unique<Imf::MultiPartInputFile>(*impl_->stream, 0, false);
  } catch (const std::exception& e) {
    fail(impl_->file, "is damaged or not an EXR file we read: {}", e.what());
  }
  for (int i = 0; i < impl_->input->parts(); ++i) {
    const Imf::Header& header = impl_->input->header(i);
    impl_->parts.push_back(check_header(impl_->file, bytes.size(), header, limits));
    const Imath::Box2i display = header.displayWindow();
    const int64_t width = int64_t{display.max.x} - display.min.x + 1;
    const int64_t height = int64_t{display.max.y} - display.min.y + 1;
    if (width < 1 || height < 1 || width > limits.max_side || height > limits.max_side) {
      fail(impl_->file, "declares an image of {} x {}; sides from 1 to {} are read", width, height,
           limits.max_side);
    }
    impl_->width = static_cast<int>(width);
    impl_->height = static_cast<int>(height);
  }
}

ExrReader::~ExrReader() = default;

int ExrReader::width() const {
  return impl_->width;
}

int ExrReader::height() const {
  return impl_->height;
}

const std::vector<ExrPartInfo>& ExrReader::parts() const {
  return impl_->parts;
}

bool ExrReader::has_part(std::string_view name) const {
  return std::any_of(impl_->parts.begin(), impl_->parts.end(),
                     [&](const ExrPartInfo& part) { return part.name == name; });
}

ExrPart ExrReader::read(std::string_view part, std::span<const std::string> channels) const {
  const auto found = std::find_if(impl_->parts.begin(), impl_->parts.end(),
                                  [&](const ExrPartInfo& info) { return info.name == part; });
  if (found == impl_->parts.end()) {
    std::vector<std::string> names;
    for (const ExrPartInfo& info : impl_->parts) names.push_back(info.name);
    fail(impl_->file, "has no part '{}'; its parts: {}", part, fmt::join(names, ", "));
  }
  for (const std::string& channel : channels) {
    if (std::find(found->channels.begin(), found->channels.end(), channel) == found->channels.end()) {
      fail(impl_->file, "part '{}' has no channel '{}'; its channels: {}", part, channel,
           fmt::join(found->channels, ", "));
    }
  }
  ExrPart result;
  result.name = std::string(part);
  result.window = found->window;
  result.channels.assign(channels.begin(), channels.end());
  result.pixels.resize(static_cast<size_t>(found->window.pixels()) * channels.size());
  try {
    Imf::InputPart input(*impl_->input, static_cast<int>(found - impl_->parts.begin()));
    const Imf::ChannelList& stored = input.header().channels();
    Imf::FrameBuffer buffer;
    result.half = true;
    for (size_t c = 0; c < channels.size(); ++c) {
      result.half = result.half && stored[channels[c]].type == Imf::HALF;
      buffer.insert(channels[c], slice(Imf::FLOAT, result.pixels.data(), found->window, channels.size(), c));
    }
    input.setFrameBuffer(buffer);
    input.readPixels(found->window.y0, found->window.y1 - 1);
  } catch (const std::exception& e) {
    fail(impl_->file, "part '{}' cannot be read: {}", part, e.what());
  }
  return result;
}

ExrPart ExrReader::read(std::string_view part) const {
  for (const ExrPartInfo& info : impl_->parts) {
    if (info.name == part) return read(part, info.channels);
  }
  return read(part, {});
}

}  // namespace opaline
