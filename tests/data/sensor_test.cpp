#include "data/sensor.h"

#include <numbers>

#include "data/encode.h"
#include "data/gamma.h"
#include "tests/data/support.h"

namespace opaline::test {
namespace {

constexpr int kSize = 64;

Scene flat_scene(const std::array<float, 3>& stokes, float flash = 50.0F) {
  Scene scene;
  scene.id = "flat";
  scene.width = scene.height = kSize;
  for (int i = 0; i < kSize * kSize; ++i) {
    for (const float s : stokes) scene.image.insert(scene.image.end(), 3, s);
  }
  scene.bsdf = scene.image;
  scene.mask.assign(static_cast<size_t>(kSize * kSize), 1);
  scene.sh.emplace();
  scene.sh->fill(0.5F);
  scene.flash = flash;
  scene.sigma_t = {1.0F, 2.0F, 3.0F};
  scene.albedo = {0.5F, 0.5F, 0.5F};
  scene.g = 0.5F;
  return scene;
}

/// The twelve planes of the first pixels.
std::vector<std::vector<double>> planes_of(const Scene& scene, const Shot& shot,
                                           Layer layer = Layer::kImage) {
  std::vector<std::vector<double>> planes(12);
  PolariserBlock block;
  std::vector<PixelIndex> pixels;
  const StokesView view{scene.image.data(), scene.image_window(), scene.width, scene.height};
  for (int32_t begin = 0; begin < kSize * kSize; begin += static_cast<int32_t>(kPixelBlock)) {
    pixels.clear();
    for (int32_t i = begin; i < begin + static_cast<int32_t>(kPixelBlock); ++i) pixels.push_back({i, i});
    photograph(view, shot, layer, pixels, block);
    for (size_t p = 0; p < 12; ++p) planes[p].insert(planes[p].end(), block[p].begin(), block[p].end());
  }
  return planes;
}

double mean(const std::vector<double>& values) {
  double sum = 0;
  for (const double v : values) sum += v;
  return sum / static_cast<double>(values.size());
}

double variance(const std::vector<double>& values) {
  const double m = mean(values);
  double sum = 0;
  for (const double v : values) sum += (v - m) * (v - m);
  return sum / static_cast<double>(values.size() - 1);
}

/// All errors of the sensor off; a test switches on what it looks at.
CaptureOptions perfect_sensor() {
  CaptureOptions options;
  options.sensor = {.on = true,
                    .noise = {0, 0, 0},
                    .gain = 0,
                    .angle = 0,
                    .extinction = 1,
                    .white_balance = 0,
                    .mosaic = false,
                    .truncate = false};
  return options;
}

TEST_CASE("off by default, and a perfect sensor changes nothing", "[sensor]") {
  CHECK(CaptureOptions{}.off());
  const Shot none = draw_shot({}, 1, 2, 3, 1000.0F);  // a flash out of range stays what it is
  CHECK(none.gain == std::array{1.0F, 1.0F, 1.0F});
  CHECK_FALSE(none.sensor);
  const Scene scene = flat_scene({0.8F, 0.3F, -0.2F});
  const auto clean = planes_of(scene, none);
  const auto same = planes_of(scene, draw_shot(perfect_sensor(), 1, 2, 3, scene.flash));
  for (size_t p = 0; p < 12; ++p) REQUIRE(std::abs(clean[p][0] - same[p][0]) <= 1e-7);
}

TEST_CASE("the exposure multiplies images and labels, and the flash stays in range", "[sensor]") {
  CaptureOptions options;
  options.exposure = {0.5, 2.0};
  double least = 10;
  double most = 0;
  for (int64_t sample = 0; sample < 300; ++sample) {
    const Shot shot = draw_shot(options, 7, 1, sample, 50.0F);
    const float k = shot.gain[0];
    CHECK(shot.gain == std::array{k, k, k});
    least = std::min(least, static_cast<double>(k));
    most = std::max(most, static_cast<double>(k));
  }
  CHECK(least >= 35.0 / 50 - 1e-6);
  CHECK(most <= 75.0 / 50 + 1e-6);
  CHECK(least < 0.72);
  CHECK(most > 1.45);
  // Without a flash the range alone counts.
  bool below = false;
  for (int64_t sample = 0; sample < 50; ++sample) {
    below = below || draw_shot(options, 7, 1, sample, std::nullopt).gain[0] < 0.6F;
  }
  CHECK(below);

  const Scene scene = flat_scene({0.4F, 0.1F, 0.0F});
  const Shot shot = draw_shot(options, 7, 1, 5, scene.flash);
  const double k = static_cast<double>(shot.gain[0]);
  const Sample sample = encode_scene(scene, EncodeOptions::paper(), {}, shot);
  const double i0 = (static_cast<double>(scene.image[0]) + static_cast<double>(scene.image[3])) / 2;
  CHECK(sample.input.at(0) == Approx(2 * std::pow(k * i0, 1 / 2.2) - 1).margin(1e-6));
  CHECK(sample.bsdf.at(0) == sample.input.at(0));
  CHECK(sample.polarised.at(0) == sample.input.at(0));
  CHECK(sample.illumination.at(0) == Approx(0.5 * k));
  CHECK(sample.illumination.at(27) == Approx(static_cast<double>(map_flash(static_cast<float>(50 * k)))));
  const Sample release = encode_scene(scene, EncodeOptions::release(), {}, shot);
  CHECK(release.sss.at(7) == sample.illumination.at(27));
}

TEST_CASE("white balance multiplies each colour's labels, the flash by the mean", "[sensor]") {
  CaptureOptions options = perfect_sensor();
  options.sensor.white_balance = 0.1;
  const Scene scene = flat_scene({0.4F, 0.1F, 0.0F});
  const Shot shot = draw_shot(options, 3, 0, 9, scene.flash);
  CHECK(shot.gain[0] != shot.gain[1]);
  const Sample sample = encode_scene(scene, EncodeOptions::paper(), {}, shot);
  double sum = 0;
  for (size_t c = 0; c < 3; ++c) {
    const double gain = static_cast<double>(shot.gain[c]);
    CHECK(std::abs(gain - 1) <= 0.1);
    CHECK(sample.illumination.at(static_cast<int64_t>(9 * c)) == Approx(0.5 * gain));
    CHECK(sample.input.at(static_cast<int64_t>(c)) ==
          Approx(2 * std::pow(0.25 * gain, 1 / 2.2) - 1).margin(1e-6));
    sum += gain;
  }
  CHECK(sample.illumination.at(27) == Approx((50 * sum / 3 - 35) / 20 - 1).margin(1e-5));
  // At the border of the range the exposure gives way.
  for (int64_t i = 0; i < 100; ++i) {
    const float flash = 75.0F * draw_shot(options, 3, 0, i, 75.0F).flash_gain();
    CHECK(flash <= 75.0001F);
    CHECK(flash >= 35.0F);
  }
}

TEST_CASE("noise has the variance c I and is white", "[sensor]") {
  CaptureOptions options = perfect_sensor();
  options.sensor.noise = {5e-5, 4.5e-5, 8e-5};
  const Scene scene = flat_scene({0.6F, 0.2F, 0.1F});
  const Shot shot = draw_shot(options, 11, 4, 2, scene.flash);
  const auto planes = planes_of(scene, shot);
  const std::array<double, 4> light = {0.4, 0.35, 0.2, 0.25};
  for (size_t p = 0; p < 12; ++p) {
    const double expected = options.sensor.noise[p % 3] * light[p / 3];
    INFO("plane " << p);
    CHECK(mean(planes[p]) == Approx(light[p / 3]).margin(5 * std::sqrt(expected / (kSize * kSize))));
    CHECK(variance(planes[p]) / expected == Approx(1.0).margin(0.15));  // 4096 values: 2.2 % is one deviation
    // Neither is a pixel's noise that of its neighbour in any plane.
    for (size_t q = 0; q < 12; ++q) {
      double correlation = 0;
      for (size_t i = 1; i < planes[p].size(); ++i) {
        correlation += (planes[p][i] - light[p / 3]) * (planes[q][i - 1] - light[q / 3]);
      }
      correlation /= kSize * kSize * std::sqrt(expected * options.sensor.noise[q % 3] * light[q / 3]);
      CHECK(std::abs(correlation) < 0.1);
    }
  }
  CHECK(planes == planes_of(scene, shot));
  CHECK(planes != planes_of(scene, shot, Layer::kBsdf));
  CHECK(planes != planes_of(scene, draw_shot(options, 11, 5, 2, scene.flash)));
  CHECK(planes != planes_of(scene, draw_shot(options, 11, 4, 3, scene.flash)));
  CHECK(planes != planes_of(scene, draw_shot(options, 12, 4, 2, scene.flash)));
}

TEST_CASE("gains, polariser angles and extinction stay within their strengths", "[sensor]") {
  CaptureOptions options = perfect_sensor();
  options.sensor.gain = 0.015;
  options.sensor.angle = 1.0;
  options.sensor.extinction = 0.97;
  double widest_angle = 0;
  double least_extinction = 1;
  for (int64_t i = 0; i < 500; ++i) {
    const Shot shot = draw_shot(options, 5, 0, i, 50.0F);
    for (size_t a = 0; a < 4; ++a) {
      CHECK(std::abs(shot.angle_gain[a] - 1) <= 0.0150001F);
      const auto c = static_cast<double>(shot.analyser[a][0]);
      const auto s = static_cast<double>(shot.analyser[a][1]);
      const double extinction = std::hypot(c, s);
      CHECK(extinction >= 0.97 - 1e-6);
      CHECK(extinction <= 1 + 1e-6);
      least_extinction = std::min(least_extinction, extinction);
      const double twice = std::numbers::pi / 2 * static_cast<double>(a);
      const double error = std::abs(std::remainder(std::atan2(s, c) - twice, 2 * std::numbers::pi));
      CHECK(error <= 2 * std::numbers::pi / 180 + 1e-6);
      widest_angle = std::max(widest_angle, error);
    }
  }
  CHECK(widest_angle > 0.9 * 2 * std::numbers::pi / 180);
  CHECK(least_extinction < 0.971);
  // What a turned analyser sees: I = (S0 + e (S1 cos 2a + S2 sin 2a)) / 2.
  const Shot shot = draw_shot(options, 5, 0, 3, 50.0F);
  const auto planes = planes_of(flat_scene({0.8F, 0.3F, -0.2F}), shot);
  for (size_t a = 0; a < 4; ++a) {
    const auto [c, s] = shot.analyser[a];
    CHECK(planes[3 * a][0] ==
          Approx(static_cast<double>(shot.angle_gain[a] * (0.8F + c * 0.3F - s * 0.2F) / 2)).margin(1e-6));
  }
}

TEST_CASE("the mosaic puts angles half a pixel apart", "[sensor]") {
  CaptureOptions options = perfect_sensor();
  options.sensor.mosaic = true;
  Scene scene = flat_scene({0.0F, 0.0F, 0.0F});
  // Light that rises by 0.01 a pixel to the right and 0.002 down.
  for (int y = 0; y < kSize; ++y) {
    for (int x = 0; x < kSize; ++x) {
      for (int c = 0; c < 3; ++c) {
        scene.image[static_cast<size_t>((y * kSize + x) * 9 + c)] =
            0.2F + 0.01F * static_cast<float>(x) + 0.002F * static_cast<float>(y);
      }
    }
  }
  const auto planes = planes_of(scene, draw_shot(options, 1, 0, 0, 50.0F));
  const size_t middle = 20 * kSize + 30;
  const double here = (0.2 + 0.3 + 0.04) / 2;
  const auto at = [&](double dx, double dy) { return here + (0.01 * dx + 0.002 * dy) / 2; };
  CHECK(planes[0][middle] == Approx(at(0.25, 0.25)).margin(1e-6));    // 0: bottom right of the cell
  CHECK(planes[3][middle] == Approx(at(0.25, -0.25)).margin(1e-6));   // 45: top right
  CHECK(planes[6][middle] == Approx(at(-0.25, -0.25)).margin(1e-6));  // 90: top left
  CHECK(planes[9][middle] == Approx(at(-0.25, 0.25)).margin(1e-6));   // 135: bottom left
}

TEST_CASE("light is clipped, and truncated to 8 bits as captures are", "[sensor]") {
  CaptureOptions options = perfect_sensor();
  options.sensor.truncate = true;
  const Scene scene = flat_scene({1.4F, 0.9F, 0.0F});  // I0 = 1.15
  const auto planes = planes_of(scene, draw_shot(options, 1, 0, 0, 50.0F));
  CHECK(planes[0][0] == 1.0);
  const double level = std::floor(255 * std::pow(0.7, 1 / 2.2));
  CHECK(planes[3][0] == Approx(std::pow((level + 0.5) / 255, 2.2)).epsilon(1e-6));
}

TEST_CASE("a scene read in part gives the bits of one read whole", "[sensor]") {
  const TempFolder folder;
  write_small_set(folder.path(), 1, 0, 64);
  const auto set = open_dataset(folder.path());
  const Scene whole = set->load(Split::kTrain, 0, {.bsdf = false});
  const Scene part = set->load(Split::kTrain, 0, {.bsdf = false, .whole = false});
  REQUIRE(part.window.has_value());
  CHECK(part.image.size() < whole.image.size());
  CaptureOptions options;
  options.sensor.on = true;
  const EncodeWanted wanted{.targets = true, .reconstruction = false};
  for (const Shot& shot : {Shot{}, draw_shot(options, 1, 0, 0, whole.flash)}) {
    const Sample a = encode_scene(whole, EncodeOptions::paper(), wanted, shot);
    const Sample b = encode_scene(part, EncodeOptions::paper(), wanted, shot);
    const auto x = std::as_const(a.input).values<float>();
    const auto y = std::as_const(b.input).values<float>();
    CHECK(std::equal(x.begin(), x.end(), y.begin(), y.end()));
  }
  const std::string message = message_of([&] { encode_scene(part, EncodeOptions::release(), wanted); });
  CHECK(contains(message, "'background' needs the whole image"));
}

}  // namespace
}  // namespace opaline::test
