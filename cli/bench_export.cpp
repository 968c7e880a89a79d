#include "cli/bench_export.h"

#include <fmt/format.h>

#include <bit>
#include <cstring>
#include <nlohmann/json.hpp>
#include <string>

#include "core/file.h"

namespace opaline::cli {
namespace {

static_assert(std::endian::native == std::endian::little);

template <class T>
void append(std::string& bytes, const T& value) {
  std::array<char, sizeof(T)> raw;
  std::memcpy(raw.data(), &value, sizeof(T));
  bytes.append(raw.data(), raw.size());
}

std::string to_ply(const render::Mesh& mesh) {
  std::string bytes = fmt::format(
      "ply\nformat binary_little_endian 1.0\nelement vertex {}\nproperty float x\nproperty float y\nproperty "
      "float z\nelement face {}\nproperty list uchar int vertex_indices\nend_header\n",
      mesh.vertices.size(), mesh.triangles.size());
  for (const auto& v : mesh.vertices) append(bytes, v);
  for (const auto& t : mesh.triangles) {
    append(bytes, uint8_t{3});
    append(bytes, t);
  }
  return bytes;
}

nlohmann::ordered_json to_json(const render::Vec3& v) {
  return {v.x, v.y, v.z};
}

}  // namespace

void export_bench_scene(const BenchScene& scene, const render::Camera& camera, const Reference& reference,
                        const std::filesystem::path& folder) {
  std::filesystem::create_directories(folder);
  write_file_atomically(folder / "body.ply", to_ply(bench_body(camera)));

  render::Illumination light;
  scene.light(light);
  nlohmann::ordered_json values = {{"spp", reference.spp}};
  for (size_t i = 0; i < 3; ++i) {
    std::vector<double> mean, variance;
    for (size_t pixel = 0; pixel < reference.covered.size(); ++pixel) {
      mean.push_back(reference.mean[9 * pixel + 3 * i]);
      variance.push_back(reference.variance[9 * pixel + 3 * i]);
    }
    values[fmt::format("S{}", i)] = {{"mean", mean}, {"variance", variance}};
  }
  for (const bool covered : reference.covered) values["covered"].push_back(covered ? 1 : 0);
  const nlohmann::ordered_json json = {
      {"name", scene.name},
      {"mesh", "body.ply"},
      {"index", render::kRefractiveIndex},
      {"camera",
       {{"width", camera.width},
        {"height", camera.height},
        {"position", to_json(camera.position)},
        {"looks_along", to_json({0.0, 0.0, -1.0})},
        {"horizontal_field_degrees", camera.field}}},
      {"medium",
       {{"sigma_t", scene.medium.sigma_t[0]}, {"albedo", scene.medium.albedo[0]}, {"g", scene.medium.g}}},
      {"environment_radiance", light.environment.radiance({0.0, 1.0, 0.0})[0]},
      {"flash",
       {{"centre", to_json(light.flash.centre)},
        {"radius", light.flash.radius},
        {"radiance", light.flash.radiance}}},
      {"reference", values}};
  write_file_atomically(folder / fmt::format("{}.json", scene.name), json.dump());
}

}  // namespace opaline::cli
