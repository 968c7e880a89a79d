#include "data/npy.h"

#include <bit>

#include "tests/data/support.h"

namespace opaline::test {
namespace {

/// A file of any type and order from the bytes of its data.
std::vector<std::byte> file_of(const std::string& descr, bool fortran, const std::string& shape,
                               const std::string& data, char version = 1) {
  const std::string head = "{'descr': '" + descr + "', 'fortran_order': " + (fortran ? "True" : "False") +
                           ", 'shape': " + shape + ", }\n";
  std::string text = std::string("\x93NUMPY", 6) + version + '\0' + static_cast<char>(head.size());
  text += std::string(version == 1 ? 1 : 3, '\0') + head + data;
  const auto bytes = std::as_bytes(std::span(text.data(), text.size()));
  return {bytes.begin(), bytes.end()};
}

template <class T>
std::string raw(std::initializer_list<T> values, bool swapped = false) {
  std::string text;
  for (const T value : values) {
    std::array<char, sizeof(T)> one = std::bit_cast<std::array<char, sizeof(T)>>(value);
    if (swapped) std::reverse(one.begin(), one.end());
    text.append(one.data(), one.size());
  }
  return text;
}

std::string refusal(const std::vector<std::byte>& bytes) {
  return message_of([&] { decode_npy(bytes, "a.npy"); });
}

TEST_CASE("npy comes back exactly", "[npy]") {
  const TempFolder folder;
  const std::vector<float> values = {1.5F, -2.0F, 0.25F, 1e-30F, 7.0F, 8.0F};
  for (const std::vector<int64_t>& shape :
       {std::vector<int64_t>{6}, std::vector<int64_t>{2, 3}, std::vector<int64_t>{1, 2, 3}}) {
    write_npy(folder / "a.npy", values, shape);
    const NpyArray array = read_npy(folder / "a.npy");
    CHECK(array.shape == shape);
    CHECK(array.values == std::vector<double>(values.begin(), values.end()));
  }
  // The header ends at a multiple of 64 bytes, as NumPy's does.
  CHECK(read_file(folder / "a.npy").size() % 64 == values.size() * 4 % 64);
}

TEST_CASE("npy types and byte orders convert", "[npy]") {
  const std::vector<double> expected = {1, -2, 3};
  CHECK(decode_npy(file_of("<f8", false, "(3,)", raw<double>({1, -2, 3})), "a").values == expected);
  CHECK(decode_npy(file_of(">f8", false, "(3,)", raw<double>({1, -2, 3}, true)), "a").values == expected);
  CHECK(decode_npy(file_of(">f4", false, "(3,)", raw<float>({1, -2, 3}, true)), "a").values == expected);
  CHECK(decode_npy(file_of("<i2", false, "(3,)", raw<int16_t>({1, -2, 3})), "a").values == expected);
  CHECK(decode_npy(file_of(">i8", false, "(3,)", raw<int64_t>({1, -2, 3}, true), 2), "a").values == expected);
  CHECK(decode_npy(file_of("|u1", false, "(3,)", raw<uint8_t>({1, 200, 3}), 3), "a").values ==
        std::vector<double>{1, 200, 3});
  CHECK(decode_npy(file_of("|b1", false, "(2,)", raw<uint8_t>({1, 0})), "a").values ==
        std::vector<double>{1, 0});
  // Halves: 1, -2, the smallest subnormal, the largest.
  const NpyArray halves =
      decode_npy(file_of("<f2", false, "(4,)", raw<uint16_t>({0x3c00, 0xc000, 0x0001, 0x7bff})), "a");
  CHECK(halves.values == std::vector<double>{1, -2, std::ldexp(1.0, -24), 65504});
  const NpyArray odd = decode_npy(file_of("<f2", false, "(2,)", raw<uint16_t>({0x7c00, 0x7e00})), "a");
  CHECK(std::isinf(odd.values[0]));
  CHECK(std::isnan(odd.values[1]));
}

TEST_CASE("npy in Fortran order is turned to rows", "[npy]") {
  // [[1, 2, 3], [4, 5, 6]] by columns.
  const NpyArray array = decode_npy(file_of("<f4", true, "(2, 3)", raw<float>({1, 4, 2, 5, 3, 6})), "a.npy");
  CHECK(array.values == std::vector<double>{1, 2, 3, 4, 5, 6});
  // 2 x 2 x 2 with value 4 i + 2 j + k at (i, j, k).
  const NpyArray cube =
      decode_npy(file_of("<f4", true, "(2, 2, 2)", raw<float>({0, 4, 2, 6, 1, 5, 3, 7})), "a.npy");
  CHECK(cube.values == std::vector<double>{0, 1, 2, 3, 4, 5, 6, 7});
}

TEST_CASE("npy that cannot be taken is refused by name", "[npy]") {
  CHECK(contains(refusal(file_of("<c8", false, "(1,)", std::string(8, '\0'))), "'<c8'"));
  CHECK(contains(refusal(file_of("|O", false, "(1,)", std::string(8, '\0'))), "'|O'"));
  CHECK(contains(refusal(file_of("<f4", false, "(4,)", raw<float>({1, 2, 3}))), "12 bytes of data"));
  CHECK(contains(refusal(file_of("<f4", false, "(2,)", raw<float>({1, 2, 3}))), "needs 8"));
  CHECK(contains(refusal(file_of("<f4", false, "(99999999, 99999999, 99999999)", "")), "declares more than"));
  CHECK(contains(refusal(file_of("<f4", false, "(-1,)", "")), "a.npy"));
  CHECK(contains(refusal(file_of("<f4", false, "(1,)", raw<float>({1}), 9)), "version 9"));
  CHECK(contains(refusal({}), "is empty"));
}

TEST_CASE("an npy cut at any byte is refused", "[npy]") {
  const std::vector<std::byte> bytes = file_of("<f4", false, "(2, 3)", raw<float>({1, 2, 3, 4, 5, 6}));
  for (size_t length = 0; length < bytes.size(); ++length) {
    const std::vector<std::byte> cut(bytes.begin(), bytes.begin() + static_cast<std::ptrdiff_t>(length));
    REQUIRE(contains(refusal(cut), "a.npy"));
  }
}

TEST_CASE("damaged npy files are parsed or refused, never more", "[npy][fuzz]") {
  const std::vector<std::byte> bytes = file_of("<f4", true, "(2, 3)", raw<float>({1, 2, 3, 4, 5, 6}));
  const int refused = parse_mutations(
      bytes, 20000, 22, [](std::span<const std::byte> mutated) { decode_npy(mutated, "a.npy"); });
  CHECK(refused > 5000);
}

}  // namespace
}  // namespace opaline::test
