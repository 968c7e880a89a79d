#include "data/exr_header.h"

#include <ImfPartType.h>

#include <array>
#include <cstdint>
#include <string_view>

#include "core/error.h"

namespace opaline {
namespace {

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

class HeaderWalk {
 public:
  HeaderWalk(std::span<const std::byte> bytes, const std::string& file) : bytes_(bytes), file_(file) {}

  size_t run() {
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
      if (multi_part && at_end_mark()) return position_ + 1;
      header();
      if (!multi_part) return position_;
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

}  // namespace

size_t check_exr_headers(std::span<const std::byte> bytes, const std::string& file) {
  return HeaderWalk(bytes, file).run();
}

Imf::Slice exr_slice(Imf::PixelType type, float* values, const Window& window, size_t channels,
                     size_t channel) {
  const auto pixel_stride = static_cast<int64_t>(channels * sizeof(float));
  const int64_t row_stride = pixel_stride * window.width();
  const int64_t offset = window.x0 * pixel_stride + window.y0 * row_stride;
  // Integer arithmetic: the address of pixel (0, 0) need not be inside the array.
  const auto base = reinterpret_cast<uintptr_t>(values + channel) - static_cast<uintptr_t>(offset);
  return {type, reinterpret_cast<char*>(base), static_cast<size_t>(pixel_stride),
          static_cast<size_t>(row_stride)};
}

}  // namespace opaline
