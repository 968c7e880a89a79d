#include "tests/fuzz/targets.h"

#include <algorithm>
#include <array>
#include <string>

#include "core/error.h"
#include "core/safetensors.h"
#include "data/exr.h"
#include "data/hdr.h"
#include "data/mesh_file.h"
#include "data/mesh_repair.h"
#include "data/npy.h"
#include "data/png.h"
#include "data/released.h"
#include "data/scene_set.h"
#include "train/config.h"

namespace opaline::fuzz {
namespace {

Bytes to_bytes(std::string_view text) {
  const auto bytes = std::as_bytes(std::span(text.data(), text.size()));
  return {bytes.begin(), bytes.end()};
}

std::string_view to_text(std::span<const std::byte> bytes) {
  return {reinterpret_cast<const char*>(bytes.data()), bytes.size()};
}

/// Calls f with each line of the text and its number.
template <class F>
void for_each_line(std::string_view text, const F& f) {
  while (!text.empty()) {
    const size_t end = std::min(text.find('\n'), text.size());
    f(text.substr(0, end));
    text.remove_prefix(std::min(end + 1, text.size()));
  }
}

// --- safetensors

std::vector<Bytes> safetensors_seeds() {
  // The writer takes a path; without the checksum, which would catch nearly every mutation of the data.
  const std::string header =
      R"({"__metadata__":{"format":"pt"},"conv.weight":{"dtype":"F32","shape":[2,3],"data_offsets":[0,24]},)"
      R"("norm.count":{"dtype":"I64","shape":[],"data_offsets":[24,32]},)"
      R"("w":{"dtype":"F64","shape":[1,2],"data_offsets":[32,48]}})";
  std::string file(8, '\0');
  file[0] = static_cast<char>(header.size() & 0xFF);
  file[1] = static_cast<char>(header.size() >> 8);
  return {to_bytes(file + header + std::string(48, '\x3f')), to_bytes(std::string("\2\0\0\0\0\0\0\0{}", 10))};
}

void parse_safetensors(std::span<const std::byte> bytes) {
  decode_safetensors(bytes, "fuzz.safetensors");
}

// --- images and arrays; the limits keep what a valid header may ask for small

std::vector<Bytes> exr_seeds() {
  const auto part = [](std::string name, Window window, std::vector<std::string> channels, bool half) {
    ExrPart result{.name = std::move(name),
                   .window = window,
                   .channels = std::move(channels),
                   .half = half,
                   .pixels = {}};
    result.pixels.assign(static_cast<size_t>(window.pixels()) * result.channels.size(), 0.25F);
    for (size_t i = 0; i < result.pixels.size(); i += 3) result.pixels[i] = static_cast<float>(i);
    return result;
  };
  const Window whole{0, 0, 20, 18};
  return {
      encode_exr({.width = 20,
                  .height = 18,
                  .parts = {part("image", whole, {"S0.B", "S0.G", "S0.R"}, true),
                            part("truth", {3, 4, 9, 11}, {"depth.Z", "mask.A"}, true)}}),
      encode_exr({.width = 20, .height = 18, .parts = {part("", whole, {"Y"}, false)}}),
  };
}

void parse_exr(std::span<const std::byte> bytes) {
  const ExrReader reader(bytes, "fuzz.exr", {.max_side = 2048, .max_values = 1 << 20});
  for (const ExrPartInfo& part : reader.parts()) reader.read(part.name);
}

std::vector<Bytes> png_seeds() {
  std::vector<uint8_t> pixels(12 * 10 * 3);
  for (size_t i = 0; i < pixels.size(); ++i) pixels[i] = static_cast<uint8_t>(i * 7);
  return {encode_png(12, 10, 3, pixels), encode_png(12, 10, 1, std::span(pixels).first(120))};
}

void parse_png(std::span<const std::byte> bytes) {
  decode_png(bytes, "fuzz.png", {.max_side = 2048, .max_pixels = 1 << 20});
}

std::vector<Bytes> hdr_seeds() {
  const std::string header = "#?RADIANCE\nEXPOSURE=1.5\nFORMAT=32-bit_rle_rgbe\n\n";
  // A new-style row of 8 pixels (a run of five and three values a channel), then a flat and an old-style one.
  std::string coded = "-Y 2 +X 8\n";
  for (int row = 0; row < 2; ++row) {
    coded += std::string("\2\2\0\10", 4);
    for (int channel = 0; channel < 4; ++channel) coded += "\x85\x70\3abc";
  }
  const std::string flat = "-Y 1 +X 4\n\x80\x40\x10\x81\1\1\1\2abcd";
  return {to_bytes(header + coded), to_bytes(header + flat)};
}

void parse_hdr(std::span<const std::byte> bytes) {
  decode_hdr(bytes, "fuzz.hdr", {.max_side = 2048, .max_pixels = 1 << 20});
}

// --- meshes, with the repair that follows

void parse_mesh(render::Surface surface) {
  repair_mesh(surface, "fuzz");
}

std::vector<Bytes> obj_seeds() {
  return {to_bytes(
      "# box\nmtllib a.mtl\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 0 0 1\nv 1 0 1\nv 1 1 1\nv 0 1 1\n"
      "vt 0 0\nvn 0 0 1\nusemtl a\nf 4 3 2 1\nf 5/1 6/1 7/1 8/1\nf 1//1 2//1 \\\n 6//1 5//1\nf 2 3 7 6\n"
      "f -6/1/1 -5/1/1 -1/1/1 -2/1/1\nf 4 1 5 8\n")};
}

void parse_obj(std::span<const std::byte> bytes) {
  parse_mesh(decode_obj(to_text(bytes), "fuzz.obj", {.max_vertices = 1 << 16, .max_triangles = 1 << 16}));
}

std::vector<Bytes> ply_seeds() {
  const std::string elements =
      "element vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 4\n"
      "property list uchar uint8 vertex_indices\nend_header\n";
  std::string binary = "ply\nformat binary_little_endian 1.0\n" + elements;
  const std::string zero(4, '\0'), one("\0\0\x80\x3f", 4);
  binary += zero + zero + zero + one + zero + zero + zero + one + zero + zero + zero + one;
  binary += std::string("\3\0\2\1\3\0\1\3\3\0\3\2\3\1\2\3", 16);
  return {to_bytes(binary), to_bytes("ply\nformat ascii 1.0\ncomment x\n" + elements +
                                     "0 0 0\n1 0 0\n0 1 0\n0 0 1\n3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n")};
}

void parse_ply(std::span<const std::byte> bytes) {
  parse_mesh(decode_ply(bytes, "fuzz.ply", {.max_vertices = 1 << 16, .max_triangles = 1 << 16}));
}

std::vector<Bytes> npy_seeds() {
  const std::vector<float> values = {1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12};
  const std::array<int64_t, 3> shape = {2, 2, 3};
  Bytes fortran = encode_npy(values, shape);
  const std::string text(to_text(fortran));
  std::string turned = text;
  turned.replace(turned.find("False"), 5, "True ");
  return {encode_npy(values, shape), to_bytes(turned)};
}

void parse_npy(std::span<const std::byte> bytes) {
  decode_npy(bytes, "fuzz.npy", 1 << 20);
}

// --- text

std::vector<Bytes> config_seeds() {
  return {to_bytes(R"(# a run
[render]
train = 3
size = 64
[data]
path = "data/small"
threads = 1
[model]
variant = "release"
image_size = 64
width = 16
inputs = ["pol4", "maxmin", "mask"]
reconstruction = true
[train]
seed = 1
batch = 32
micro_batch = 16
beta1 = 0.5
schedule = "epoch"
[stage1]
epochs = 3
learning_rate = 2e-4
freeze = ["normal"]
[loss]
normal = { weight = 100.0, kind = "cosine" }
)"),
          to_bytes("a.b.c = [1, [2, {x = 1979-05-27T07:32:00Z}]]\n'k' = \"\"\"\\u00e9\"\"\"\n")};
}

void parse_config(std::span<const std::byte> bytes) {
  parse_run_config(to_text(bytes), "fuzz.toml");
}

std::vector<Bytes> index_seeds() {
  SceneRecord record;
  record.id = "000017";
  record.file = "scenes/000017.exr";
  record.xxh64 = "0123456789abcdef";
  record.box = {3, 4, 20, 30};
  record.coverage = 0.25;
  record.sigma_t = {1, 2, 3};
  record.albedo = {0.5, 0.6, 0.7};
  record.g = 0.3;
  record.flash = 0.5;
  record.object = "blob";
  record.environment = "sky";
  record.seed = 12345678901234567890U;
  record.spp = 64;
  record.seconds = 1.5;
  const std::string line = to_json_line(record);
  record.sections.emplace();
  for (FileSection& section : *record.sections) section = {.bytes = 1234, .xxh64 = "0123456789abcdef"};
  return {to_bytes(line + "\n" + to_json_line(record) + "\n")};
}

void parse_index(std::span<const std::byte> bytes) {
  for_each_line(to_text(bytes), [](std::string_view line) { parse_scene_record(line, "fuzz.jsonl:1"); });
}

std::vector<Bytes> csv_seeds() {
  return {
      to_bytes("12;bunny;forest;bump;50.5;0.1,0.2,0.3;0.5,0.6,0.7;0.4;1.0;0;90;0;0.1;0.2;0.3;0;180;0;1\n"
               "13;a;b;c;75;[0.1, 0.2, 0.3];0.95,0.3,0.5;0.9;1;2;3;4;5;6;7;8;9;10;11\r\n")};
}

void parse_csv(std::span<const std::byte> bytes) {
  for_each_line(to_text(bytes), [](std::string_view line) { parse_released_record(line, "train.csv:1"); });
}

constexpr std::array<Target, 10> kTargets = {{
    {"safetensors", safetensors_seeds, parse_safetensors},
    {"exr", exr_seeds, parse_exr},
    {"png", png_seeds, parse_png},
    {"hdr", hdr_seeds, parse_hdr},
    {"obj", obj_seeds, parse_obj},
    {"ply", ply_seeds, parse_ply},
    {"npy", npy_seeds, parse_npy},
    {"config", config_seeds, parse_config},
    {"scene_index", index_seeds, parse_index},
    {"released_csv", csv_seeds, parse_csv},
}};

}  // namespace

std::span<const Target> targets() {
  return kTargets;
}

void run(const Target& target, std::span<const std::byte> bytes) {
  try {
    target.parse(bytes);
  } catch (const Error&) {
    // A refusal is an answer.
  }
}

}  // namespace opaline::fuzz
