// Triangle meshes from OBJ and PLY files. Polygons become fans of triangles; materials, normals and texture
// coordinates are ignored.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>

#include "data/render/surface.h"

namespace opaline {

/// Sizes over these are refused before anything of that size is allocated.
struct MeshLimits {
  int64_t max_vertices = int64_t{1} << 25;
  int64_t max_triangles = int64_t{1} << 25;
};

/// The decoders take the bytes of a file; `file` is for messages. Damage, indices out of range, numbers that
/// are not finite and sizes over the limits are errors with file and line (text) or element (binary).
/// The surfaces are as the files have them: maybe open, of any size (data/mesh_repair.h).

/// Wavefront OBJ: `v` and `f`, with vertex / texture / normal in any of their forms and negative indices;
/// other statements of the format are ignored, anything else is an error.
render::Surface decode_obj(std::string_view text, const std::string& file, const MeshLimits& limits = {});
/// PLY (Turk 1994), ASCII and binary in either byte order: x, y, z of element `vertex`, the list
/// `vertex_indices` or `vertex_index` of element `face`; other elements and properties are skipped.
render::Surface decode_ply(std::span<const std::byte> bytes, const std::string& file,
                           const MeshLimits& limits = {});

/// By the name's end, .obj or .ply in any case.
bool is_mesh_file(const std::filesystem::path& path);
render::Surface read_mesh(const std::filesystem::path& path, const MeshLimits& limits = {});

}  // namespace opaline
