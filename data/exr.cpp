#include "data/exr.h"

#include <ImfChannelList.h>
#include <ImfFrameBuffer.h>
#include <ImfHeader.h>
#include <ImfIO.h>
#include <ImfInputPart.h>
#include <ImfMultiPartInputFile.h>

#include <algorithm>
#include <array>
#include <cstring>
#include <exception>

#include "core/error.h"
#include "data/exr_header.h"

namespace opaline {
namespace {

/// OpenEXR reads from here; every access is checked against what there is.
class MemoryInput final : public Imf::IStream {
 public:
  MemoryInput(std::span<const ExrBytes> ranges, int64_t file_bytes, const std::string& file)
      : Imf::IStream(file.c_str()),
        ranges_(ranges.begin(), ranges.end()),
        end_(static_cast<uint64_t>(file_bytes)) {}

  bool read(char to[], int count) override {
    const auto size = static_cast<uint64_t>(count);
    if (count < 0 || size > end_ - position_) throw Error("the file ends early");
    for (const ExrBytes& range : ranges_) {
      const auto begin = static_cast<uint64_t>(range.offset);
      if (position_ < begin || position_ - begin > range.bytes.size()) continue;
      if (size > range.bytes.size() - (position_ - begin)) continue;
      std::memcpy(to, range.bytes.data() + (position_ - begin), size);
      position_ += size;
      return position_ < end_;
    }
    throw Error(fmt::format("bytes {} to {} are needed, but were not read", position_, position_ + size));
  }
  uint64_t tellg() override { return position_; }
  void seekg(uint64_t position) override {
    if (position > end_) throw Error("the file ends early");
    position_ = position;
  }

 private:
  std::vector<ExrBytes> ranges_;
  uint64_t end_;
  uint64_t position_ = 0;
};

std::string part_name(const Imf::Header& header) {
  return header.hasName() ? header.name() : std::string();
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

}  // namespace

std::string to_string(const Window& window) {
  return fmt::format("[{}, {}) x [{}, {})", window.x0, window.x1, window.y0, window.y1);
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
    : ExrReader(std::array<ExrBytes, 1>{{{0, bytes}}}, static_cast<int64_t>(bytes.size()), std::move(file),
                limits) {}

ExrReader::ExrReader(std::span<const ExrBytes> ranges, int64_t file_bytes, std::string file,
                     const ExrLimits& limits)
    : impl_(std::make_unique<Impl>()) {
  impl_->file = std::move(file);
  if (ranges.empty() || ranges.front().offset != 0) fail(impl_->file, "was not read from its beginning");
  check_exr_headers(ranges.front().bytes, impl_->file);
  try {
    // OpenEXR's own cap: it sizes its line tables from the data window while it reads the header.
    Imf::Header::setMaxImageSize(ExrLimits().max_side, ExrLimits().max_side);
    impl_->stream = std::make_unique<MemoryInput>(ranges, file_bytes, impl_->file);
    impl_->input = std::make_unique<Imf::MultiPartInputFile>(*impl_->stream, 0, false);
  } catch (const std::exception& e) {
    fail(impl_->file, "is damaged or not an EXR file we read: {}", e.what());
  }
  for (int i = 0; i < impl_->input->parts(); ++i) {
    const Imf::Header& header = impl_->input->header(i);
    impl_->parts.push_back(check_header(impl_->file, static_cast<size_t>(file_bytes), header, limits));
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

ExrPart ExrReader::read(std::string_view part, std::span<const std::string> channels,
                        const std::optional<ExrRows>& rows) const {
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
  if (rows) {
    result.window.y0 = std::max(result.window.y0, rows->begin);
    result.window.y1 = std::min(result.window.y1, rows->end);
    if (result.window.height() < 1) {
      fail(impl_->file, "part '{}' has window {}: no rows of [{}, {})", part, to_string(found->window),
           rows->begin, rows->end);
    }
  }
  result.channels.assign(channels.begin(), channels.end());
  result.pixels.resize(static_cast<size_t>(result.window.pixels()) * channels.size());
  try {
    Imf::InputPart input(*impl_->input, static_cast<int>(found - impl_->parts.begin()));
    const Imf::ChannelList& stored = input.header().channels();
    Imf::FrameBuffer buffer;
    result.half = true;
    for (size_t c = 0; c < channels.size(); ++c) {
      result.half = result.half && stored[channels[c]].type == Imf::HALF;
      buffer.insert(channels[c],
                    exr_slice(Imf::FLOAT, result.pixels.data(), result.window, channels.size(), c));
    }
    input.setFrameBuffer(buffer);
    input.readPixels(result.window.y0, result.window.y1 - 1);
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
