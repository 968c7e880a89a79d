#include "data/npy.h"

#include <bit>
#include <charconv>
#include <cmath>
#include <cstring>
#include <string_view>

#include "core/error.h"
#include "core/file.h"

namespace opaline {
namespace {

constexpr std::string_view kMagic("\x93NUMPY", 6);

struct NpyHeader {
  std::string descr;
  bool fortran_order = false;
  std::vector<int64_t> shape;
};

/// Reads the header, a Python dictionary of three known keys.
class HeaderParser {
 public:
  HeaderParser(std::string_view text, const std::string& file) : text_(text), file_(file) {}

  NpyHeader parse() {
    NpyHeader header;
    bool descr = false;
    bool order = false;
    bool shape = false;
    expect('{');
    while (!accept('}')) {
      const std::string key = quoted();
      expect(':');
      if (key == "descr" && !descr) {
        skip_space();
        if (at_ < text_.size() && text_[at_] == '[') fail(file_, "holds records; a plain array is expected");
        header.descr = quoted();
        descr = true;
      } else if (key == "fortran_order" && !order) {
        header.fortran_order = boolean();
        order = true;
      } else if (key == "shape" && !shape) {
        header.shape = tuple();
        shape = true;
      } else {
        fail(file_, "has an unexpected or double key '{}' in its header", key);
      }
      if (!accept(',')) {
        expect('}');
        break;
      }
    }
    if (!descr || !order || !shape) fail(file_, "lacks descr, fortran_order or shape in its header");
    return header;
  }

 private:
  void skip_space() {
    while (at_ < text_.size() && (text_[at_] == ' ' || text_[at_] == '\n' || text_[at_] == '\t')) ++at_;
  }
  bool accept(char c) {
    skip_space();
    if (at_ >= text_.size() || text_[at_] != c) return false;
    ++at_;
    return true;
  }
  void expect(char c) {
    if (!accept(c)) fail(file_, "has a damaged header: '{}' expected at character {}", c, at_);
  }
  std::string quoted() {
    skip_space();
    const char quote = at_ < text_.size() ? text_[at_] : '\0';
    if (quote != '\'' && quote != '"')
      fail(file_, "has a damaged header: text expected at character {}", at_);
    const size_t end = text_.find(quote, at_ + 1);
    if (end == std::string_view::npos) fail(file_, "has a damaged header: text without end");
    const std::string value(text_.substr(at_ + 1, end - at_ - 1));
    at_ = end + 1;
    return value;
  }
  bool boolean() {
    skip_space();
    for (const std::string_view word : {"True", "False"}) {
      if (text_.substr(at_).starts_with(word)) {
        at_ += word.size();
        return word == "True";
      }
    }
    fail(file_, "has a damaged header: True or False expected at character {}", at_);
  }
  std::vector<int64_t> tuple() {
    std::vector<int64_t> values;
    expect('(');
    while (!accept(')')) {
      skip_space();
      int64_t value = 0;
      const auto [end, error] = std::from_chars(text_.data() + at_, text_.data() + text_.size(), value);
      if (error != std::errc() || value < 0) {
        fail(file_, "has a damaged header: a size expected at character {}", at_);
      }
      at_ = static_cast<size_t>(end - text_.data());
      values.push_back(value);
      constexpr size_t kMaxDims = 32;
      if (values.size() > kMaxDims) fail(file_, "has over {} dimensions", kMaxDims);
      if (!accept(',')) {
        expect(')');
        break;
      }
    }
    return values;
  }

  std::string_view text_;
  const std::string& file_;
  size_t at_ = 0;
};

double half_to_double(uint16_t bits) {
  const int exponent = bits >> 10 & 31;
  const int fraction = bits & 1023;
  double value = 0;
  if (exponent == 31) {
    value = fraction == 0 ? HUGE_VAL : std::nan("");
  } else if (exponent == 0) {
    value = std::ldexp(fraction, -24);
  } else {
    value = std::ldexp(1024 + fraction, exponent - 25);
  }
  return (bits & 0x8000) != 0 ? -value : value;
}

/// `size` bytes as an unsigned number.
uint64_t load(const std::byte* from, size_t size, bool big_endian) {
  uint64_t value = 0;
  for (size_t i = 0; i < size; ++i) {
    const size_t at = big_endian ? i : size - 1 - i;
    value = value << 8 | std::to_integer<uint64_t>(from[at]);
  }
  return value;
}

double to_double(uint64_t bits, char kind, size_t size) {
  if (kind == 'f') {
    if (size == 2) return half_to_double(static_cast<uint16_t>(bits));
    if (size == 4) return static_cast<double>(std::bit_cast<float>(static_cast<uint32_t>(bits)));
    return std::bit_cast<double>(bits);
  }
  if (kind == 'i') {
    const unsigned unused = 64 - 8 * static_cast<unsigned>(size);
    return static_cast<double>(static_cast<int64_t>(bits << unused) >> unused);
  }
  return static_cast<double>(bits);
}

/// Kind ('f', 'i', 'u', 'b') and size of an element.
struct ElementType {
  char kind = 'f';
  size_t size = 4;
  bool big_endian = false;
};

ElementType element_type(const std::string& descr, const std::string& file) {
  const auto refuse = [&]() -> ElementType {
    fail(file, "has type '{}'; floats, integers and booleans are read", descr);
  };
  if (descr.size() != 3 || std::string_view("<>=|").find(descr[0]) == std::string_view::npos) refuse();
  const ElementType type{
      .kind = descr[1], .size = static_cast<size_t>(descr[2] - '0'), .big_endian = descr[0] == '>'};
  const bool power = type.size == 1 || type.size == 2 || type.size == 4 || type.size == 8;
  const bool known = (type.kind == 'f' && power && type.size > 1) ||
                     ((type.kind == 'i' || type.kind == 'u') && power) ||
                     (type.kind == 'b' && type.size == 1);
  return known ? type : refuse();
}

}  // namespace

NpyArray decode_npy(std::span<const std::byte> bytes, const std::string& file, int64_t max_values) {
  if (bytes.empty()) fail(file, "is empty");
  if (bytes.size() < 10 || std::memcmp(bytes.data(), kMagic.data(), kMagic.size()) != 0) {
    fail(file, "is not an npy file (wrong first bytes)");
  }
  const auto version = std::to_integer<int>(bytes[6]);
  if (version < 1 || version > 3) fail(file, "has npy version {}; 1 to 3 are read", version);
  const size_t length_size = version == 1 ? 2 : 4;
  const size_t text_at = 8 + length_size;
  if (bytes.size() < text_at) fail(file, "ends inside its header");
  const uint64_t length = load(bytes.data() + 8, length_size, false);
  if (length > bytes.size() - text_at) {
    fail(file, "ends inside its header ({} bytes declared, {} left)", length, bytes.size() - text_at);
  }
  const std::string_view text(reinterpret_cast<const char*>(bytes.data()) + text_at, length);
  const NpyHeader header = HeaderParser(text, file).parse();
  const ElementType type = element_type(header.descr, file);

  int64_t count = 1;
  for (const int64_t n : header.shape) {
    if (n != 0 && count > max_values / n) fail(file, "declares more than {} values", max_values);
    count *= n;
  }
  const std::span<const std::byte> data = bytes.subspan(text_at + length);
  const auto needed = static_cast<uint64_t>(count) * type.size;
  if (data.size() != needed) {
    fail(file, "has {} bytes of data; shape ({}) of type {} needs {}", data.size(),
         fmt::join(header.shape, ", "), header.descr, needed);
  }

  NpyArray array{.shape = header.shape, .values = {}};
  array.values.resize(static_cast<size_t>(count));
  const auto value = [&](int64_t i) {
    return to_double(load(data.data() + static_cast<size_t>(i) * type.size, type.size, type.big_endian),
                     type.kind, type.size);
  };
  if (!header.fortran_order) {
    for (int64_t i = 0; i < count; ++i) array.values[static_cast<size_t>(i)] = value(i);
    return array;
  }
  // Fortran order: the first index runs fastest in the file, the last one in ours.
  std::vector<int64_t> index(header.shape.size(), 0);
  for (int64_t i = 0; i < count; ++i) {
    int64_t to = 0;
    for (size_t d = 0; d < index.size(); ++d) to = to * header.shape[d] + index[d];
    array.values[static_cast<size_t>(to)] = value(i);
    for (size_t d = 0; d < index.size() && ++index[d] == header.shape[d]; ++d) index[d] = 0;
  }
  return array;
}

NpyArray read_npy(const std::filesystem::path& path, int64_t max_values) {
  constexpr int64_t kMaxBytes = int64_t{1} << 32;
  return decode_npy(read_file(path, kMaxBytes), path.string(), max_values);
}

std::vector<std::byte> encode_npy(std::span<const float> values, std::span<const int64_t> shape) {
  int64_t count = 1;
  std::string sizes;
  for (const int64_t n : shape) {
    count *= n;
    sizes += fmt::format("{}, ", n);
  }
  if (count != static_cast<int64_t>(values.size())) {
    fail("write npy", "{} values for shape ({})", values.size(), fmt::join(shape, ", "));
  }
  if (shape.size() > 1) sizes.resize(sizes.size() - 2);
  std::string head = fmt::format("{{'descr': '<f4', 'fortran_order': False, 'shape': ({}), }}", sizes);
  // The data starts at a multiple of 64 bytes, as NumPy writes it.
  const size_t before = kMagic.size() + 4;
  head.resize((before + head.size() + 1 + 63) / 64 * 64 - before - 1, ' ');
  head += '\n';
  std::string text(kMagic);
  text += '\x01';
  text += '\x00';
  text += static_cast<char>(head.size() & 0xff);
  text += static_cast<char>(head.size() >> 8);
  text += head;
  static_assert(std::endian::native == std::endian::little);
  std::vector<std::byte> bytes(text.size() + values.size_bytes());
  std::memcpy(bytes.data(), text.data(), text.size());
  if (!values.empty()) std::memcpy(bytes.data() + text.size(), values.data(), values.size_bytes());
  return bytes;
}

void write_npy(const std::filesystem::path& path, std::span<const float> values,
               std::span<const int64_t> shape) {
  write_file_atomically(path, encode_npy(values, shape));
}

}  // namespace opaline
