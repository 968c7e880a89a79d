#include "data/hdr.h"

#include <array>
#include <charconv>
#include <cmath>
#include <string_view>

#include "core/error.h"
#include "core/file.h"

namespace opaline {
namespace {

using Rgbe = std::array<uint8_t, 4>;

class HdrParser {
 public:
  HdrParser(std::span<const std::byte> bytes, const std::string& file, const HdrLimits& limits)
      : bytes_(bytes), file_(file), limits_(limits) {}

  HdrImage parse() {
    header();
    // Run-length coding packs at most 127 values of a channel into two bytes.
    const int64_t pixels = int64_t{image_.width} * image_.height;
    if (pixels * 4 > static_cast<int64_t>(bytes_.size() - at_) * 127) {
      fail(file_, "declares {} x {} pixels, more than {} bytes can hold", image_.width, image_.height,
           bytes_.size());
    }
    image_.pixels.resize(static_cast<size_t>(pixels) * 3);
    std::vector<Rgbe> row(static_cast<size_t>(image_.width));
    for (row_ = 0; row_ < image_.height; ++row_) {
      read_row(row);
      float* out = image_.pixels.data() + static_cast<size_t>(row_) * row.size() * 3;
      for (const Rgbe& c : row) {
        // Ward, "Real pixels", Graphics Gems II, 1991: mantissas of eight bits under one exponent.
        const double scale = c[3] == 0 ? 0.0 : std::ldexp(1.0, c[3] - 136) / exposure_;
        for (size_t k = 0; k < 3; ++k) *out++ = static_cast<float>((c[k] + 0.5 * (c[3] != 0)) * scale);
      }
    }
    return std::move(image_);
  }

 private:
  std::string_view line() {
    const std::string_view rest(reinterpret_cast<const char*>(bytes_.data()) + at_, bytes_.size() - at_);
    const size_t end = rest.find('\n');
    if (end == std::string_view::npos || end > 4096) fail(file_, "its header has no end");
    at_ += end + 1;
    return rest.substr(0, end);
  }

  void header() {
    const std::string_view magic = line();
    if (magic != "#?RADIANCE" && magic != "#?RGBE") fail(file_, "does not begin with #?RADIANCE");
    for (std::string_view text = line(); !text.empty(); text = line()) {
      if (text.starts_with("FORMAT=") && text != "FORMAT=32-bit_rle_rgbe") {
        fail(file_, "has the format {}; 32-bit_rle_rgbe is read", text.substr(7, 40));
      }
      if (text.starts_with("EXPOSURE=")) {
        text.remove_prefix(9);
        while (text.starts_with(' ')) text.remove_prefix(1);
        double value = 0.0;
        std::from_chars(text.data(), text.data() + text.size(), value);
        if (!(value > 1e-6 && value < 1e6)) fail(file_, "has the exposure \"{}\"", text.substr(0, 40));
        exposure_ *= value;
      }
    }
    if (!(exposure_ > 1e-9 && exposure_ < 1e9)) fail(file_, "has an exposure of {}", exposure_);
    const std::string_view size = line();
    image_.height = number(size, "-Y ");
    image_.width = number(size, " +X ");
    if (image_.width > limits_.max_side || image_.height > limits_.max_side ||
        int64_t{image_.width} * image_.height > limits_.max_pixels) {
      fail(file_, "declares {} x {} pixels; at most {} a side and {} in all are read", image_.width,
           image_.height, limits_.max_side, limits_.max_pixels);
    }
  }

  int number(std::string_view text, std::string_view before) const {
    const size_t found = text.find(before);
    int value = 0;
    if (found != std::string_view::npos) {
      const std::string_view digits = text.substr(found + before.size());
      std::from_chars(digits.data(), digits.data() + digits.size(), value);
    }
    if (value < 1) fail(file_, "has the size \"{}\"; \"-Y height +X width\" is read", text.substr(0, 40));
    return value;
  }

  uint8_t byte() {
    if (at_ >= bytes_.size()) fail(file_, "ends early, in row {} of {}", row_, image_.height);
    return static_cast<uint8_t>(bytes_[at_++]);
  }

  void read_row(std::vector<Rgbe>& row) {
    const Rgbe first{byte(), byte(), byte(), byte()};
    const bool coded = first[0] == 2 && first[1] == 2 && first[2] < 128 && row.size() >= 8 &&
                       row.size() < 32768 && size_t{first[2]} * 256 + first[3] == row.size();
    if (!coded) {
      read_flat(first, row);
      return;
    }
    for (size_t channel = 0; channel < 4; ++channel) {
      for (size_t i = 0; i < row.size();) {
        const uint8_t code = byte();
        const size_t count = code > 128 ? code - 128U : code;
        if (count == 0 || count > row.size() - i) {
          fail(file_, "row {} has a run of {} at column {} of {}", row_, count, i, row.size());
        }
        const uint8_t value = code > 128 ? byte() : uint8_t{0};
        for (size_t k = 0; k < count; ++k) row[i++][channel] = code > 128 ? value : byte();
      }
    }
  }

  /// Pixel by pixel; (1, 1, 1, n) repeats the one before, n times, 256 n times where it follows another such.
  void read_flat(Rgbe pixel, std::vector<Rgbe>& row) {
    size_t i = 0;
    int shift = 0;
    for (;;) {
      if (pixel[0] == 1 && pixel[1] == 1 && pixel[2] == 1) {
        const size_t count = shift < 32 ? size_t{pixel[3]} << shift : row.size() + 1;
        if (i == 0 || count > row.size() - i) fail(file_, "row {} repeats a pixel {} times", row_, count);
        for (size_t k = 0; k < count; ++k, ++i) row[i] = row[i - 1];
        shift += 8;
      } else {
        row[i++] = pixel;
        shift = 0;
      }
      if (i == row.size()) return;
      pixel = {byte(), byte(), byte(), byte()};
    }
  }

  std::span<const std::byte> bytes_;
  const std::string& file_;
  const HdrLimits& limits_;
  size_t at_ = 0;
  int row_ = 0;
  double exposure_ = 1.0;
  HdrImage image_;
};

}  // namespace

HdrImage decode_hdr(std::span<const std::byte> bytes, const std::string& file, const HdrLimits& limits) {
  return HdrParser(bytes, file, limits).parse();
}

HdrImage read_hdr(const std::filesystem::path& path, const HdrLimits& limits) {
  return decode_hdr(read_file(path, int64_t{1} << 31), path.string(), limits);
}

}  // namespace opaline
