// What reader and writer of EXR files share; part of data/exr.h.
#pragma once

#include <ImfFrameBuffer.h>

#include <cstddef>
#include <span>
#include <string>

#include "data/window.h"

namespace opaline {

/// Walks the headers before OpenEXR sees them. It trusts what it reads: a size field may make it allocate
/// gigabytes, and a value longer than its size shifts all that follows. So every size must lie inside the
/// file and be that of its type, and kinds of data that we do not read are refused by name.
/// `bytes` are the first of the file; returns where the headers end and the line tables begin.
size_t check_exr_headers(std::span<const std::byte> bytes, const std::string& file);

/// Bytes from the start of `values` to the value of pixel (0, 0), which may lie outside of it.
Imf::Slice exr_slice(Imf::PixelType type, float* values, const Window& window, size_t channels,
                     size_t channel);

}  // namespace opaline
