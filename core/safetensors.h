// The safetensors file format: an 8-byte little-endian header length, a JSON header, then the raw tensors.
#pragma once

#include <filesystem>
#include <map>
#include <span>
#include <string>
#include <vector>

#include "core/tensor.h"

namespace opaline {

/// Tensors by name, in name order.
using TensorMap = std::map<std::string, Tensor>;

struct SafetensorsFile {
  TensorMap tensors;
  std::map<std::string, std::string> metadata;  ///< the header's "__metadata__"
};

/// Reads a file; types F32, F64, I64. Checks everything before it allocates: header length (at most 100 MB
/// and inside the file), JSON, duplicate names, spans that overlap, leave gaps or end elsewhere than the
/// file, shape x type against span. With a `xxh64` entry in the metadata (ours have one) the data is checked
/// too. Throws Error naming the file and the tensor.
SafetensorsFile load_safetensors(const std::filesystem::path& path);
/// The same for bytes in memory; `file` is for messages.
SafetensorsFile decode_safetensors(std::span<const std::byte> bytes, const std::string& file);

/// Writes to a temporary name beside `path`, syncs, renames; adds the checksum of the data to the metadata.
void save_safetensors(const std::filesystem::path& path, const TensorMap& tensors,
                      const std::map<std::string, std::string>& metadata = {});

}  // namespace opaline
