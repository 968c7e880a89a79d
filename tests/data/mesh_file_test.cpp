#include "data/mesh_file.h"

#include <catch2/catch.hpp>
#include <cstring>

#include "data/mesh_repair.h"
#include "tests/data/support.h"

using namespace opaline;
using render::Surface;
using render::Vec3;

namespace {

std::span<const std::byte> bytes_of(const std::string& text) {
  return std::as_bytes(std::span(text.data(), text.size()));
}

Surface obj(const std::string& text) {
  return decode_obj(text, "a.obj");
}
Surface ply(const std::string& text) {
  return decode_ply(bytes_of(text), "a.ply");
}

std::string obj_of(const Surface& surface) {
  std::string text;
  for (const Vec3& p : surface.points) text += fmt::format("v {} {} {}\n", p.x, p.y, p.z);
  for (const auto& t : surface.triangles) text += fmt::format("f {} {} {}\n", t[0] + 1, t[1] + 1, t[2] + 1);
  return text;
}

/// A binary PLY of a tetrahedron in either byte order, with a colour to skip.
std::string binary_ply(bool big) {
  std::string text = fmt::format(
      "ply\nformat binary_{}_endian 1.0\ncomment by hand\nelement vertex 4\nproperty float x\nproperty "
      "double y\n"
      "property float z\nproperty uchar red\nelement face 4\nproperty list uchar int "
      "vertex_indices\nend_header\n",
      big ? "big" : "little");
  const auto put = [&]<class T>(T value) {
    std::array<char, sizeof(T)> raw{};
    std::memcpy(raw.data(), &value, sizeof(T));
    if (big) std::reverse(raw.begin(), raw.end());
    text.append(raw.data(), raw.size());
  };
  const std::array<std::array<double, 3>, 4> points = {{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}}};
  for (const auto& p : points) {
    put(static_cast<float>(p[0]));
    put(p[1]);
    put(static_cast<float>(p[2]));
    put(uint8_t{200});
  }
  const std::array<std::array<int32_t, 3>, 4> faces = {{{0, 2, 1}, {0, 1, 3}, {0, 3, 2}, {1, 2, 3}}};
  for (const auto& face : faces) {
    put(uint8_t{3});
    for (const int32_t i : face) put(i);
  }
  return text;
}

Surface ball(int sides = 6) {
  return render::to_surface(render::cube_sphere(sides));
}

/// Appends b, scaled and moved.
void append(Surface& a, const Surface& b, double scale, const Vec3& shift) {
  const auto first = static_cast<uint32_t>(a.points.size());
  for (const Vec3& p : b.points) a.points.push_back(p * scale + shift);
  for (const auto& t : b.triangles) a.triangles.push_back({t[0] + first, t[1] + first, t[2] + first});
}

}  // namespace

TEST_CASE("OBJ faces are read in all their forms") {
  const Surface surface =
      obj("# a comment\nmtllib x.mtl\nv 0 0 0\nv 1 0 0 1\nv +1 1 0 0.5 0.5 0.5\nv 0 1e0 0\nvt 0 0\nvn 0 0 "
          "1\no box\ns off\n"
          "f 1 2 3 4\nf 1/1 2/1 3/1\nf 1//1 2//1 \\\n 3//1\nf -4/1/1 -3/1/1 -2/1/1 # behind\r\n");
  CHECK(surface.points.size() == 4);
  REQUIRE(surface.triangles.size() == 5);
  CHECK(surface.triangles[1] == std::array<uint32_t, 3>{0, 2, 3});
  CHECK(surface.triangles[3] == surface.triangles[2]);
  CHECK(surface.triangles[4] == surface.triangles[2]);
  CHECK(surface.points[2].y == 1.0);
}

TEST_CASE("damaged OBJ files are refused with file and line") {
  const auto message = [](const std::string& text) { return test::message_of([&] { obj(text); }); };
  CHECK_THAT(message("v 0 0 0\nv 1 x 0\n"), Catch::Contains("a.obj:2") && Catch::Contains("\"x\""));
  CHECK_THAT(message("v 0 0 nan\n"), Catch::Contains("a.obj:1"));
  CHECK_THAT(message("v 0 0\n"), Catch::Contains("a.obj:1"));
  CHECK_THAT(message("v 0 0 0\nf 1 1 2\n"), Catch::Contains("vertex 2; there are 1"));
  CHECK_THAT(message("v 0 0 0\nf 1 1 -2\n"), Catch::Contains("vertex -2"));
  CHECK_THAT(message("v 0 0 0\nf 1 0 1\n"), Catch::Contains("vertex 0"));
  CHECK_THAT(message("v 0 0 0\nf 1 1\n"), Catch::Contains("2 corners"));
  CHECK_THAT(message("v 0 0 0\n\n\\\n\nf 1 a 1\n"), Catch::Contains("a.obj:5"));
  CHECK_THAT(message("solid box\n"), Catch::Contains("\"solid\" is no statement"));
  CHECK_THROWS_AS(decode_obj("v 0 0 0\nv 0 0 0\n", "a.obj", {.max_vertices = 1}), Error);
}

TEST_CASE("PLY files are read in three encodings") {
  const Surface ascii =
      ply("ply\r\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
          "element face 3\nproperty uchar flag\nproperty list uchar int vertex_index\nelement edge "
          "1\nproperty int a\n"
          "end_header\n0 0 0\n1 0 0\n0 1 0\n0 0 1\n7 3 0 2 1\n7 3 0 1 3\n7 4 0 3 2 1\n5\n");
  CHECK(ascii.points.size() == 4);
  CHECK(ascii.triangles.size() == 4);
  for (const bool big : {false, true}) {
    const Surface binary = ply(binary_ply(big));
    REQUIRE(binary.points.size() == 4);
    CHECK(binary.points[2].y == 1.0);
    CHECK(binary.points[3].z == 1.0);
    CHECK(describe_leak(render::to_mesh(binary)) == "");
    CHECK(enclosed_volume(render::to_mesh(binary)) == Approx(1.0 / 6.0));
  }
}

TEST_CASE("damaged PLY files are refused") {
  const auto message = [](const std::string& text) { return test::message_of([&] { ply(text); }); };
  const std::string head = "ply\nformat ascii 1.0\n";
  const std::string xyz = "property float x\nproperty float y\nproperty float z\n";
  CHECK_THAT(message("plx\n"), Catch::Contains("\"ply\""));
  CHECK_THAT(message(head), Catch::Contains("no end"));
  CHECK_THAT(message("ply\nformat ebcdic 1.0\nend_header\n"), Catch::Contains("format"));
  CHECK_THAT(message(head + "element vertex 99999999999\n" + xyz + "end_header\n0 0 0\n"),
             Catch::Contains("declares 99999999999"));
  CHECK_THAT(message(head + "element vertex -1\n" + xyz + "end_header\n"),
             Catch::Contains("number of elements"));
  CHECK_THAT(message(head + "element vertex 1\nproperty float x\nend_header\n0\n"), Catch::Contains("no y"));
  CHECK_THAT(message(head + "element vertex 2\n" + xyz + "end_header\n0 0 0\n"),
             Catch::Contains("ends early"));
  CHECK_THAT(message(head + "element vertex 1\n" + xyz +
                     "element face 1\nproperty list uchar int vertex_indices\nend_header\n0 0 0\n3 0 0 1\n"),
             Catch::Contains("face 0 uses vertex 1 of 1"));
  CHECK_THAT(message(head + "element point 9\nend_header\n0 0 0 0 0\n"),
             Catch::Contains("without a property"));
  const std::string whole = binary_ply(false);
  CHECK_THAT(message(whole.substr(0, whole.size() - 3)), Catch::Contains("ends early"));
}

TEST_CASE("what cannot be parsed is refused, never more") {
  const std::string text = obj_of(ball(1)), binary = binary_ply(true);
  const auto read = [](std::span<const std::byte> bytes) {
    Surface surface = decode_obj({reinterpret_cast<const char*>(bytes.data()), bytes.size()}, "a.obj");
    repair_mesh(surface, "a.obj");
  };
  CHECK(test::parse_mutations({bytes_of(text).begin(), bytes_of(text).end()}, 300, 1, read) > 100);
  const auto read_binary = [](std::span<const std::byte> bytes) { decode_ply(bytes, "a.ply"); };
  CHECK(test::parse_mutations({bytes_of(binary).begin(), bytes_of(binary).end()}, 1000, 2, read_binary) >
        100);
}

TEST_CASE("repair welds, turns, fills and measures") {
  // A soup: every triangle with points of its own, every third one turned, two neighbours missing.
  const Surface whole = ball();
  Surface soup;
  for (size_t i = 2; i < whole.triangles.size(); ++i) {
    std::array<uint32_t, 3> t{};
    for (size_t k = 0; k < 3; ++k) {
      t[k] = static_cast<uint32_t>(soup.points.size());
      soup.points.push_back(whole.points[whole.triangles[i][k]] * 37.0 + Vec3{5.0, 0.0, -2.0});
    }
    if (i % 3 == 0) std::swap(t[0], t[1]);
    soup.triangles.push_back(t);
  }
  soup.triangles.push_back(soup.triangles.front());
  soup.triangles.push_back({0, 0, 1});
  // The hole of this coarse ball is too long to be filled.
  Surface refused = soup;
  CHECK_THAT(test::message_of([&] { repair_mesh(refused, "soup"); }),
             Catch::Contains("soup") && Catch::Contains("a hole of 4 edges"));

  const Surface fine = ball(60);
  Surface holed = fine;
  holed.triangles.erase(holed.triangles.begin(), holed.triangles.begin() + 2);
  for (size_t i = 0; i < holed.triangles.size(); i += 3)
    std::swap(holed.triangles[i][0], holed.triangles[i][1]);
  holed.triangles.push_back({0, 0, 1});
  const MeshRepair repair = repair_mesh(holed, "holed");
  CHECK(repair.filled == 1);
  CHECK(repair.dropped == 1);
  CHECK(repair.turned > 0);
  CHECK(describe_leak(render::to_mesh(holed)) == "");
  CHECK(enclosed_volume(render::to_mesh(holed)) > 0.5);  // of a ball in the box's ball
  CHECK_FALSE(holed.curved);
  CHECK(holed.thickness > 0.05);

  Surface welded = fine;
  welded.points.insert(welded.points.end(), fine.points.begin(), fine.points.end());
  const auto shift = static_cast<uint32_t>(fine.points.size());
  for (size_t i = 0; i < welded.triangles.size(); i += 2)
    for (uint32_t& v : welded.triangles[i]) v += shift;
  CHECK(repair_mesh(welded, "welded").merged > 1000);
}

TEST_CASE("an inside-out body is turned; a piece inside another is a cavity") {
  Surface inside_out = ball();
  for (auto& t : inside_out.triangles) std::swap(t[0], t[1]);
  repair_mesh(inside_out, "a");
  CHECK(enclosed_volume(render::to_mesh(inside_out)) > 0.0);

  Surface hollow = ball(20);
  append(hollow, ball(20), 0.5, {0.1, 0.0, 0.0});
  const double full = [] {
    Surface b = ball(20);
    repair_mesh(b, "ball");
    return enclosed_volume(render::to_mesh(b));
  }();
  CHECK(repair_mesh(hollow, "hollow").cavities == 1);
  CHECK(enclosed_volume(render::to_mesh(hollow)) == Approx(full * 0.875).epsilon(1e-3));
}

TEST_CASE("bodies that cannot be made whole are refused with the reason") {
  const auto reason = [](Surface surface) { return test::message_of([&] { repair_mesh(surface, "a"); }); };
  CHECK_THAT(reason({}), Catch::Contains("no faces"));
  CHECK_THAT(reason({.points = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0}}, .triangles = {{0, 1, 2}}}),
             Catch::Contains("a hole of 3 edges"));
  CHECK_THAT(reason({.points = {{1, 1, 1}}, .triangles = {{0, 0, 0}}}), Catch::Contains("no size"));
  Surface crossing = ball(12);
  append(crossing, ball(12), 1.0, {0.7, 0.1, 0.0});
  CHECK_THAT(reason(crossing), Catch::Contains("intersect"));
  Surface fin = ball();
  fin.points.push_back({2, 2, 2});
  fin.triangles.push_back(
      {fin.triangles[0][0], fin.triangles[0][1], static_cast<uint32_t>(fin.points.size() - 1)});
  CHECK_THAT(reason(fin), Catch::Contains("3 triangles share an edge"));
  // A Moebius strip of ten quads.
  Surface strip;
  for (int i = 0; i < 10; ++i) {
    const double a = 0.6283185 * i;
    const Vec3 out{std::cos(a), std::sin(a), 0.0};
    const Vec3 side = out * std::cos(0.5 * a) + Vec3{0.0, 0.0, std::sin(0.5 * a)};
    strip.points.push_back(out * 2.0 + side);
    strip.points.push_back(out * 2.0 - side);
  }
  for (uint32_t i = 0; i < 10; ++i) {
    const bool last = i == 9;
    const uint32_t a = 2 * i, b = a + 1, c = last ? 1 : a + 2, d = last ? 0 : a + 3;
    strip.triangles.push_back({a, b, d});
    strip.triangles.push_back({a, d, c});
  }
  CHECK_THAT(reason(strip), Catch::Contains("Moebius"));
}
