#include "core/safetensors.h"

#include <catch2/catch.hpp>
#include <cstring>
#include <filesystem>
#include <string>
#include <vector>

#include "core/file.h"
#include "core/memory.h"
#include "tests/core/support.h"

namespace opaline {
namespace {

using test::TemporaryFolder;

void write_raw(const std::filesystem::path& path, const std::string& header, size_t data_bytes,
               uint64_t declared) {
  std::string bytes(8, '\0');
  std::memcpy(bytes.data(), &declared, 8);
  bytes += header + std::string(data_bytes, '\1');
  write_file_atomically(path, bytes);
}

void write_raw(const std::filesystem::path& path, const std::string& header, size_t data_bytes) {
  write_raw(path, header, data_bytes, header.size());
}

/// The message of a load that must fail; nothing may have been allocated for its tensors.
std::string refusal(const std::filesystem::path& path) {
  tensor_pool().reset_peak();
  const int64_t before = tensor_pool().bytes_in_use();
  std::string message;
  try {
    load_safetensors(path);
  } catch (const Error& error) {
    message = error.what();
  }
  CHECK(tensor_pool().peak_bytes() == before);
  return message;
}

TEST_CASE("tensors and metadata come back as they were") {
  const TemporaryFolder folder;
  TensorMap tensors;
  tensors["a.weight"] = Tensor::from({1.5, -2, 3, 4, 5, 6}, {2, 3});
  tensors["b"] = Tensor::from({1e300}, {1}, DType::kFloat64);
  tensors["count"] = Tensor::from({7}, {}, DType::kInt64);
  tensors["empty"] = Tensor::zeros({0, 3});
  save_safetensors(folder / "file", tensors, {{"step", "12"}});
  const SafetensorsFile file = load_safetensors(folder / "file");
  REQUIRE(file.tensors.size() == 4);
  for (const auto& [name, tensor] : tensors) {
    INFO(name);
    const Tensor& found = file.tensors.at(name);
    CHECK(found.shape() == tensor.shape());
    CHECK(found.dtype() == tensor.dtype());
    CHECK(std::memcmp(found.bytes(), tensor.bytes(), static_cast<size_t>(tensor.byte_size())) == 0);
  }
  CHECK(file.metadata.at("step") == "12");
  CHECK(file.metadata.at("xxh64").size() == 16);
}

TEST_CASE("a file of another writer, without a checksum, is read") {
  const TemporaryFolder folder;
  write_raw(
      folder / "file",
      R"({"b":{"dtype":"F32","shape":[1],"data_offsets":[8,12]},"a":{"dtype":"F32","shape":[2],"data_offsets":[0,8]}}   )",
      12);
  CHECK(load_safetensors(folder / "file").tensors.size() == 2);
  write_raw(folder / "none", "{}", 0);
  CHECK(load_safetensors(folder / "none").tensors.empty());
}

// faults.md of the format: 1, each before anything is allocated.
TEST_CASE("damaged and hostile files are refused before allocation") {
  const TemporaryFolder folder;
  const std::filesystem::path path = folder / "weights.safetensors";
  const std::string name = path.string();
  struct Fault {
    std::string header;
    size_t data_bytes;
    std::vector<std::string> named;
  };
  const std::string good = R"("good":{"dtype":"F32","shape":[2],"data_offsets":[0,8]})";
  const std::vector<Fault> faults = {
      {"{\"a\":", 0, {"JSON"}},
      {"[1,2]", 0, {"not a JSON object"}},
      {"", 0, {"JSON"}},
      {"{" + good + "," + good + "}", 8, {"\"good\" twice"}},
      {R"({"a":{"dtype":"F32","dtype":"F64","shape":[1],"data_offsets":[0,8]}})", 8, {"\"dtype\" twice"}},
      {"{" + good + R"(,"bad":{"dtype":"F32","shape":[2],"data_offsets":[4,12]}})", 12, {"bad", "overlap"}},
      {"{" + good + R"(,"bad":{"dtype":"F32","shape":[1],"data_offsets":[12,16]}})", 16, {"bad", "gap"}},
      {R"({"bad":{"dtype":"F32","shape":[1],"data_offsets":[4,8]}})", 8, {"bad", "gap"}},
      {"{" + good + "}", 12, {"end at byte 8", "12"}},
      {"{" + good + "}", 4, {"end at byte 8", "4", "truncated"}},
      {R"({"bad":{"dtype":"F32","shape":[3],"data_offsets":[0,8]}})", 8, {"bad", "F32", "3", "12", "8"}},
      {R"({"bad":{"dtype":"F64","shape":[2],"data_offsets":[0,8]}})", 8, {"bad", "F64", "16", "8"}},
      {R"({"bad":{"dtype":"BF16","shape":[4],"data_offsets":[0,8]}})", 8, {"bad", "BF16"}},
      {R"({"bad":{"dtype":7,"shape":[4],"data_offsets":[0,8]}})", 8, {"bad"}},
      {R"({"bad":{"shape":[2],"data_offsets":[0,8]}})", 8, {"bad", "dtype"}},
      {R"({"bad":{"dtype":"F32","data_offsets":[0,8]}})", 8, {"bad", "shape"}},
      {R"({"bad":{"dtype":"F32","shape":[2]}})", 8, {"bad", "data_offsets"}},
      {R"({"bad":{"dtype":"F32","shape":[-2],"data_offsets":[0,8]}})", 8, {"bad", "-2"}},
      {R"({"bad":{"dtype":"F32","shape":[2.5],"data_offsets":[0,8]}})", 8, {"bad", "2.5"}},
      {R"({"bad":{"dtype":"F32","shape":"2","data_offsets":[0,8]}})", 8, {"bad"}},
      {R"({"bad":{"dtype":"F32","shape":[2],"data_offsets":[0]}})", 8, {"bad", "data_offsets"}},
      {R"({"bad":{"dtype":"F32","shape":[2],"data_offsets":[8,0]}})", 8, {"bad"}},
      {R"({"bad":{"dtype":"F32","shape":[2],"data_offsets":[-8,0]}})", 8, {"bad"}},
      {R"({"bad":{"dtype":"F32","shape":[4611686018427387904,4],"data_offsets":[0,0]}})",
       0,
       {"bad", "impossible"}},
      {R"({"bad":{"dtype":"F32","shape":[0,18446744073709551615],"data_offsets":[0,0]}})", 0, {"bad"}},
      {R"({"bad":{"dtype":"F32","shape":[1000000000000],"data_offsets":[0,4000000000000]}})",
       8,
       {"4000000000000"}},
      {R"({"bad":3})", 0, {"bad"}},
      {R"({"__metadata__":{"n":3}})", 0, {"metadata", "n"}},
      {R"({"__metadata__":[3]})", 0, {"metadata"}},
      {R"({"__metadata__":3})", 0, {"metadata"}},
  };
  for (const Fault& fault : faults) {
    write_raw(path, fault.header, fault.data_bytes);
    const std::string message = refusal(path);
    INFO(fault.header << " gave: " << message);
    CHECK(message.find(name) != std::string::npos);
    for (const std::string& part : fault.named) {
      INFO("looking for: " << part);
      CHECK(message.find(part) != std::string::npos);
    }
  }
}

TEST_CASE("header lengths that cannot be are refused") {
  const TemporaryFolder folder;
  const std::filesystem::path path = folder / "w.safetensors";
  write_file_atomically(path, std::string("1234567"));
  CHECK_THAT(refusal(path), Catch::Contains("7 bytes") && Catch::Contains("w.safetensors"));
  write_raw(path, "{}", 0, 100);
  CHECK_THAT(refusal(path), Catch::Contains("header of 100 bytes") && Catch::Contains("truncated"));
  write_raw(path, "{}", 0, 100'000'001);
  CHECK_THAT(refusal(path), Catch::Contains("100000001") && Catch::Contains("100 MB"));
  write_raw(path, "{}", 0, UINT64_MAX);
  CHECK_THAT(refusal(path), Catch::Contains("100 MB"));
}

TEST_CASE("deep nesting in a header does not overflow the stack") {
  const TemporaryFolder folder;
  std::string deep = R"({"a":)";
  deep += std::string(2'000'000, '[');
  write_raw(folder / "deep", deep, 0);
  CHECK_THAT(refusal(folder / "deep"), Catch::Contains("JSON"));
  write_raw(folder / "closed", R"({"a":)" + std::string(1'000'000, '[') + std::string(1'000'000, ']') + "}",
            0);
  CHECK(!refusal(folder / "closed").empty());
}

TEST_CASE("a file cut short at any byte is refused") {
  const TemporaryFolder folder;
  save_safetensors(folder / "whole", {{"a", Tensor::from({1, 2, 3}, {3})}, {"b", Tensor::from({4}, {1})}});
  const std::string whole = read_text(folder / "whole");
  for (size_t size = 0; size < whole.size(); ++size) {
    write_file_atomically(folder / "cut", std::string_view(whole).substr(0, size));
    INFO(size << " of " << whole.size() << " bytes");
    CHECK(!refusal(folder / "cut").empty());
  }
}

// 6: a flipped bit.
TEST_CASE("a flipped bit in the data is caught by the checksum") {
  const TemporaryFolder folder;
  save_safetensors(folder / "whole", {{"a", Tensor::from({1, 2, 3}, {3})}});
  const std::string whole = read_text(folder / "whole");
  for (size_t byte = whole.size() - 12; byte < whole.size(); ++byte) {
    for (const int bit : {0, 7}) {
      std::string flipped = whole;
      flipped[byte] = static_cast<char>(flipped[byte] ^ (1 << bit));
      write_file_atomically(folder / "flipped", flipped);
      CHECK_THAT(refusal(folder / "flipped"), Catch::Contains("checksum") && Catch::Contains("flipped"));
    }
  }
}

TEST_CASE("a failed save leaves the old file") {
  const TemporaryFolder folder;
  save_safetensors(folder / "file", {{"a", Tensor::from({1}, {1})}});
  CHECK_THROWS_AS(save_safetensors(folder / "none/file", {{"a", Tensor::from({2}, {1})}}), Error);
  CHECK(load_safetensors(folder / "file").tensors.at("a").at(0) == 1.0);
}

}  // namespace
}  // namespace opaline
