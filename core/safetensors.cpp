#include "core/safetensors.h"

#include <algorithm>
#include <bit>
#include <cstring>
#include <nlohmann/json.hpp>
#include <set>
#include <span>

#include "core/file.h"

namespace opaline {
namespace {

static_assert(std::endian::native == std::endian::little, "safetensors is little-endian");

constexpr uint64_t kMaxHeader = 100'000'000;

DType parse_dtype(const std::string& file, const std::string& name, const std::string& text) {
  if (text == "F32") return DType::kFloat32;
  if (text == "F64") return DType::kFloat64;
  if (text == "I64") return DType::kInt64;
  fail(file, "tensor {} has type {}; F32, F64 and I64 are known", name, text);
}

std::string format_dtype(DType dtype) {
  switch (dtype) {
    case DType::kFloat32:
      return "F32";
    case DType::kFloat64:
      return "F64";
    case DType::kInt64:
      return "I64";
  }
  return "";
}

struct Entry {
  std::string name;
  DType dtype{};
  Shape shape;
  int64_t begin = 0;
  int64_t end = 0;
};

nlohmann::json parse_header(const std::string& file, std::string_view text) {
  // nlohmann keeps the last of two equal keys; a file with two is damaged or hostile.
  std::vector<std::set<std::string>> keys;
  const auto watch = [&](int, nlohmann::json::parse_event_t event, nlohmann::json& parsed) {
    if (event == nlohmann::json::parse_event_t::object_start) keys.emplace_back();
    if (event == nlohmann::json::parse_event_t::object_end) keys.pop_back();
    if (event == nlohmann::json::parse_event_t::key &&
        !keys.back().insert(parsed.get<std::string>()).second) {
      fail(file, "the header has the key \"{}\" twice", parsed.get<std::string>());
    }
    return true;
  };
  try {
    auto header = nlohmann::json::parse(text, watch);
    if (!header.is_object()) fail(file, "the header is not a JSON object");
    return header;
  } catch (const nlohmann::json::exception& error) {
    fail(file, "the header is not valid JSON: {}", error.what());
  }
}

Entry parse_entry(const std::string& file, const std::string& name, const nlohmann::json& value) {
  Entry entry;
  entry.name = name;
  try {
    entry.dtype = parse_dtype(file, name, value.at("dtype").get<std::string>());
    for (const auto& size : value.at("shape")) {
      if (!size.is_number_unsigned()) fail(file, "tensor {} has the size {} in its shape", name, size.dump());
      entry.shape.push_back(size.get<int64_t>());
    }
    const auto& offsets = value.at("data_offsets");
    if (offsets.size() != 2 || !offsets[0].is_number_unsigned() || !offsets[1].is_number_unsigned()) {
      fail(file, "tensor {} has the data_offsets {}", name, offsets.dump());
    }
    entry.begin = offsets[0].get<int64_t>();
    entry.end = offsets[1].get<int64_t>();
  } catch (const nlohmann::json::exception& error) {
    fail(file, "tensor {}: {}", name, error.what());
  }
  // The product must not overflow before it is compared with the span.
  int64_t bytes = size_of(entry.dtype);
  for (const int64_t size : entry.shape) {
    if (size < 0 || __builtin_mul_overflow(bytes, size, &bytes)) {
      fail(file, "tensor {} has the impossible shape {}", name, to_string(entry.shape));
    }
  }
  if (entry.begin < 0 || entry.end < entry.begin || bytes != entry.end - entry.begin) {
    fail(file, "tensor {} of type {} and shape {} needs {} bytes, its span [{}, {}) has {}", name,
         format_dtype(entry.dtype), to_string(entry.shape), bytes, entry.begin, entry.end,
         entry.end - entry.begin);
  }
  return entry;
}

}  // namespace

SafetensorsFile load_safetensors(const std::filesystem::path& path) {
  return decode_safetensors(read_file(path), path.string());
}

SafetensorsFile decode_safetensors(std::span<const std::byte> bytes, const std::string& file) {
  if (bytes.size() < 8) fail(file, "has {} bytes, too short for a safetensors file", bytes.size());
  uint64_t header_size = 0;
  std::memcpy(&header_size, bytes.data(), 8);
  if (header_size > kMaxHeader) fail(file, "declares a header of {} bytes, more than 100 MB", header_size);
  if (header_size > bytes.size() - 8) {
    fail(file, "declares a header of {} bytes, but has only {}: truncated?", header_size, bytes.size() - 8);
  }
  const auto header =
      parse_header(file, {reinterpret_cast<const char*>(bytes.data()) + 8, static_cast<size_t>(header_size)});
  const std::span<const std::byte> data = bytes.subspan(8 + static_cast<size_t>(header_size));

  SafetensorsFile result;
  std::vector<Entry> entries;
  for (const auto& [name, value] : header.items()) {
    if (name == "__metadata__") {
      for (const auto& [key, text] : value.items()) {
        if (!text.is_string()) fail(file, "metadata entry {} is not a string", key);
        result.metadata[key] = text.get<std::string>();
      }
    } else {
      entries.push_back(parse_entry(file, name, value));
    }
  }
  std::sort(entries.begin(), entries.end(), [](const Entry& a, const Entry& b) {
    return std::tie(a.begin, a.end) < std::tie(b.begin, b.end);
  });
  int64_t position = 0;
  for (const Entry& entry : entries) {
    if (entry.begin != position) {
      fail(file, "tensor {} begins at byte {}, expected {}: spans {}", entry.name, entry.begin, position,
           entry.begin < position ? "overlap" : "leave a gap");
    }
    position = entry.end;
  }
  if (position != static_cast<int64_t>(data.size())) {
    fail(file, "the tensors end at byte {} of the data, the file has {}: truncated or damaged", position,
         data.size());
  }
  if (const auto checksum = result.metadata.find("xxh64"); checksum != result.metadata.end()) {
    if (const std::string actual = to_hex(xxh64(data)); actual != checksum->second) {
      fail(file, "checksum {} does not match the recorded {}: the file is damaged", actual, checksum->second);
    }
  }
  for (const Entry& entry : entries) {
    Tensor tensor(entry.shape, entry.dtype);
    if (entry.end > entry.begin) {
      std::memcpy(tensor.bytes(), data.data() + entry.begin, static_cast<size_t>(entry.end - entry.begin));
    }
    result.tensors.emplace(entry.name, std::move(tensor));
  }
  return result;
}

void save_safetensors(const std::filesystem::path& path, const TensorMap& tensors,
                      const std::map<std::string, std::string>& metadata) {
  nlohmann::json header = nlohmann::json::object();
  int64_t position = 0;
  for (const auto& [name, tensor] : tensors) {
    const int64_t end = position + tensor.byte_size();
    header[name] = {{"dtype", format_dtype(tensor.dtype())},
                    {"shape", tensor.shape()},
                    {"data_offsets", {position, end}}};
    position = end;
  }
  std::vector<std::byte> data(static_cast<size_t>(position));
  size_t offset = 0;
  for (const auto& [name, tensor] : tensors) {
    const auto bytes = static_cast<size_t>(tensor.byte_size());
    if (bytes > 0) std::memcpy(data.data() + offset, tensor.bytes(), bytes);
    offset += bytes;
  }
  header["__metadata__"] = metadata;
  header["__metadata__"]["xxh64"] = to_hex(xxh64(data));
  std::string text = header.dump();
  text.resize((text.size() + 7) / 8 * 8, ' ');  // the data stays 8-byte aligned

  std::vector<std::byte> bytes(8 + text.size());
  const uint64_t header_size = text.size();
  std::memcpy(bytes.data(), &header_size, 8);
  std::memcpy(bytes.data() + 8, text.data(), text.size());
  bytes.insert(bytes.end(), data.begin(), data.end());
  write_file_atomically(path, bytes);
}

}  // namespace opaline
