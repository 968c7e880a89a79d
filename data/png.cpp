#include "data/png.h"

#include <png.h>

#include <algorithm>
#include <array>
#include <csetjmp>
#include <cstring>

#include "core/error.h"
#include "core/file.h"

namespace opaline {
namespace {

/// What libpng reports through its callbacks. libpng leaves a failed call by longjmp, which must not pass
/// over C++ objects with destructors: the functions that call it hold plain values only.
struct Failure {
  std::array<char, 256> message{};

  void set(const char* text) {
    const size_t n = std::min(std::strlen(text), message.size() - 1);
    std::memcpy(message.data(), text, n);
    message[n] = '\0';
  }
};

[[noreturn]] void on_error(png_structp png, png_const_charp message) {
  static_cast<Failure*>(png_get_error_ptr(png))->set(message);
  png_longjmp(png, 1);
}

void on_warning(png_structp, png_const_charp) {}

struct Source {
  std::span<const std::byte> bytes;
  size_t position = 0;
};

void on_read(png_structp png, png_bytep to, png_size_t count) {
  auto* source = static_cast<Source*>(png_get_io_ptr(png));
  if (count > source->bytes.size() - source->position) png_error(png, "the file ends early");
  std::memcpy(to, source->bytes.data() + source->position, count);
  source->position += count;
}

void on_write(png_structp png, png_bytep from, png_size_t count) {
  auto* sink = static_cast<std::vector<std::byte>*>(png_get_io_ptr(png));
  const auto* first = reinterpret_cast<const std::byte*>(from);
  sink->insert(sink->end(), first, first + count);
}

void on_flush(png_structp) {}

/// libpng's pair of structs for reading.
class ReadStruct {
 public:
  explicit ReadStruct(Failure* failure)
      : png_(png_create_read_struct(PNG_LIBPNG_VER_STRING, failure, on_error, on_warning)),
        info_(png_ == nullptr ? nullptr : png_create_info_struct(png_)) {}
  ReadStruct(const ReadStruct&) = delete;
  ReadStruct& operator=(const ReadStruct&) = delete;
  ~ReadStruct() { png_destroy_read_struct(&png_, &info_, nullptr); }
  png_structp png() const { return png_; }
  png_infop info() const { return info_; }

 private:
  png_structp png_;
  png_infop info_;
};

class WriteStruct {
 public:
  explicit WriteStruct(Failure* failure)
      : png_(png_create_write_struct(PNG_LIBPNG_VER_STRING, failure, on_error, on_warning)),
        info_(png_ == nullptr ? nullptr : png_create_info_struct(png_)) {}
  WriteStruct(const WriteStruct&) = delete;
  WriteStruct& operator=(const WriteStruct&) = delete;
  ~WriteStruct() { png_destroy_write_struct(&png_, &info_); }
  png_structp png() const { return png_; }
  png_infop info() const { return info_; }

 private:
  png_structp png_;
  png_infop info_;
};

/// Reads up to the pixels and sets up their conversion. False after a failure.
bool start(png_structp png, png_infop info, const PngLimits& limits) {
  if (setjmp(png_jmpbuf(png)) != 0) return false;
  png_set_user_limits(png, static_cast<png_uint_32>(limits.max_side),
                      static_cast<png_uint_32>(limits.max_side));
  // Ancillary chunks (texts, profiles) say nothing we use; their damage is no damage of the image.
  png_set_chunk_malloc_max(png, 1 << 20);
  png_read_info(png, info);
  if (png_get_color_type(png, info) == PNG_COLOR_TYPE_PALETTE) png_set_palette_to_rgb(png);
  if (png_get_color_type(png, info) == PNG_COLOR_TYPE_GRAY && png_get_bit_depth(png, info) < 8) {
    png_set_expand_gray_1_2_4_to_8(png);
  }
  if (png_get_valid(png, info, PNG_INFO_tRNS) != 0) png_set_tRNS_to_alpha(png);
  png_set_interlace_handling(png);
  png_read_update_info(png, info);
  return true;
}

bool read_pixels(png_structp png, png_bytepp rows) {
  if (setjmp(png_jmpbuf(png)) != 0) return false;
  png_read_image(png, rows);
  png_read_end(png, nullptr);
  return true;
}

bool write_pixels(png_structp png, png_infop info, int width, int height, int channels, png_bytepp rows) {
  if (setjmp(png_jmpbuf(png)) != 0) return false;
  png_set_IHDR(png, info, static_cast<png_uint_32>(width), static_cast<png_uint_32>(height), 8,
               channels == 1 ? PNG_COLOR_TYPE_GRAY : PNG_COLOR_TYPE_RGB, PNG_INTERLACE_NONE,
               PNG_COMPRESSION_TYPE_DEFAULT, PNG_FILTER_TYPE_DEFAULT);
  png_write_info(png, info);
  png_write_image(png, rows);
  png_write_end(png, info);
  return true;
}

constexpr std::array<uint8_t, 8> kSignature = {0x89, 'P', 'N', 'G', '\r', '\n', 0x1a, '\n'};

void check_signature(std::span<const std::byte> bytes, const std::string& file) {
  if (bytes.empty()) fail(file, "is empty");
  if (bytes.size() < kSignature.size() ||
      std::memcmp(bytes.data(), kSignature.data(), kSignature.size()) != 0) {
    fail(file, "is not a PNG file (wrong first bytes)");
  }
}

/// Width and height as the first chunk declares them, before anything is allocated by them.
PngSize declared_size(std::span<const std::byte> bytes, const std::string& file) {
  check_signature(bytes, file);
  constexpr size_t kWidthAt = 16;
  if (bytes.size() < kWidthAt + 8 || std::memcmp(bytes.data() + 12, "IHDR", 4) != 0) {
    fail(file, "ends inside its header");
  }
  const auto u32 = [&](size_t at) {
    uint32_t value = 0;
    for (size_t i = 0; i < 4; ++i) value = value << 8 | std::to_integer<uint32_t>(bytes[at + i]);
    return value;
  };
  const uint32_t width = u32(kWidthAt);
  const uint32_t height = u32(kWidthAt + 4);
  constexpr uint32_t kMax = 0x7fffffff;
  if (width == 0 || height == 0 || width > kMax || height > kMax) {
    fail(file, "declares {} x {} pixels", width, height);
  }
  return {static_cast<int>(width), static_cast<int>(height)};
}

/// Bytes (big-endian where 16-bit) to samples, without the alpha channel, which must be opaque.
std::vector<uint16_t> to_samples(std::span<const uint8_t> raw, int bits, int stored, int kept,
                                 const std::string& file) {
  const size_t step = bits == 16 ? 2 : 1;
  const size_t pixels = raw.size() / (static_cast<size_t>(stored) * step);
  const int opaque = bits == 16 ? 65535 : 255;
  std::vector<uint16_t> samples;
  samples.reserve(pixels * static_cast<size_t>(kept));
  size_t at = 0;
  for (size_t i = 0; i < pixels; ++i) {
    for (int c = 0; c < stored; ++c, at += step) {
      const int value = bits == 16 ? raw[at] << 8 | raw[at + 1] : raw[at];
      if (c < kept) {
        samples.push_back(static_cast<uint16_t>(value));
      } else if (value != opaque) {
        fail(file, "has transparent pixels (alpha {} of {}); save it without an alpha channel", value,
             opaque);
      }
    }
  }
  return samples;
}

}  // namespace

PngImage decode_png(std::span<const std::byte> bytes, const std::string& file, const PngLimits& limits) {
  const PngSize size = declared_size(bytes, file);
  if (size.width > limits.max_side || size.height > limits.max_side ||
      int64_t{size.width} * size.height > limits.max_pixels) {
    fail(file, "declares {} x {} pixels, over the limit of {} a side and {} in all", size.width, size.height,
         limits.max_side, limits.max_pixels);
  }
  Failure failure;
  const ReadStruct reader(&failure);
  if (reader.info() == nullptr) fail(file, "libpng cannot start: {}", failure.message.data());
  Source source{.bytes = bytes};
  png_set_read_fn(reader.png(), &source, on_read);
  if (!start(reader.png(), reader.info(), limits)) fail(file, "is damaged: {}", failure.message.data());

  PngImage image;
  image.width = static_cast<int>(png_get_image_width(reader.png(), reader.info()));
  image.height = static_cast<int>(png_get_image_height(reader.png(), reader.info()));
  image.bits = png_get_bit_depth(reader.png(), reader.info());
  const int stored = png_get_channels(reader.png(), reader.info());
  image.channels = stored <= 2 ? 1 : 3;
  const size_t row_bytes = png_get_rowbytes(reader.png(), reader.info());
  // Deflate shrinks at most 1032 to 1: a file that is too short for its rows is known before they are made.
  constexpr size_t kMaxRatio = 1032;
  if (row_bytes * static_cast<size_t>(image.height) / kMaxRatio > bytes.size()) {
    fail(file, "declares {} x {} pixels but has {} bytes only", image.width, image.height, bytes.size());
  }
  std::vector<uint8_t> raw(row_bytes * static_cast<size_t>(image.height));
  std::vector<png_bytep> rows;
  for (int y = 0; y < image.height; ++y) rows.push_back(raw.data() + row_bytes * static_cast<size_t>(y));
  if (!read_pixels(reader.png(), rows.data())) fail(file, "is damaged: {}", failure.message.data());
  image.samples = to_samples(raw, image.bits, stored, image.channels, file);
  return image;
}

PngImage read_png(const std::filesystem::path& path, const PngLimits& limits) {
  constexpr int64_t kMaxBytes = int64_t{1} << 30;
  return decode_png(read_file(path, kMaxBytes), path.string(), limits);
}

PngSize read_png_size(const std::filesystem::path& path) {
  constexpr int64_t kMaxBytes = int64_t{1} << 30;
  return declared_size(read_file(path, kMaxBytes), path.string());
}

std::vector<std::byte> encode_png(int width, int height, int channels, std::span<const uint8_t> pixels) {
  const auto count = static_cast<int64_t>(pixels.size());
  if (width < 1 || height < 1 || (channels != 1 && channels != 3) ||
      count != int64_t{width} * height * channels) {
    fail("write PNG", "{} values for an image of {} x {} with {} channels", count, width, height, channels);
  }
  Failure failure;
  std::vector<std::byte> bytes;
  const WriteStruct writer(&failure);
  if (writer.info() == nullptr) fail("write PNG", "libpng cannot start: {}", failure.message.data());
  png_set_write_fn(writer.png(), &bytes, on_write, on_flush);
  const size_t row_bytes = static_cast<size_t>(width) * static_cast<size_t>(channels);
  std::vector<png_bytep> rows;
  for (int y = 0; y < height; ++y) {
    // libpng's interface lacks a const; it does not write to rows it encodes.
    rows.push_back(const_cast<png_bytep>(pixels.data() + row_bytes * static_cast<size_t>(y)));
  }
  if (!write_pixels(writer.png(), writer.info(), width, height, channels, rows.data())) {
    fail("write PNG", "{}", failure.message.data());
  }
  return bytes;
}

void write_png(const std::filesystem::path& path, int width, int height, int channels,
               std::span<const uint8_t> pixels) {
  write_file_atomically(path, encode_png(width, height, channels, pixels));
}

}  // namespace opaline
