#include "data/encode.h"

#include <numbers>

#include "tests/data/support.h"

namespace opaline::test {
namespace {

constexpr int kSize = 32;

/// One Stokes value for every pixel and colour; the left half is the object.
Scene flat_scene(float s0, float s1, float s2) {
  Scene scene;
  scene.id = "flat";
  scene.source = "nowhere";
  scene.width = kSize;
  scene.height = kSize;
  for (int i = 0; i < kSize * kSize; ++i) {
    scene.image.insert(scene.image.end(), {s0, s0, s0, s1, s1, s1, s2, s2, s2});
    scene.bsdf.insert(scene.bsdf.end(), {s0 / 2, s0 / 2, s0 / 2, 0, 0, 0, 0, 0, 0});
    scene.normal.insert(scene.normal.end(), {0.6F, 0.0F, 0.8F});
    scene.depth.push_back(0.25F);
    scene.mask.push_back(i % kSize < kSize / 2 ? 1 : 0);
  }
  scene.sh.emplace();
  for (size_t i = 0; i < 27; ++i) (*scene.sh)[i] = static_cast<float>(i) / 10;
  scene.flash = 55;
  scene.sigma_t = {0.0F, 16.0F, 32.0F};
  scene.albedo = {0.3F, 0.625F, 0.95F};
  scene.g = 0.45F;
  return scene;
}

double encoded(double linear) {
  return 2 * std::pow(std::clamp(linear, 0.0, 1.0), 1 / 2.2) - 1;
}

std::vector<double> pixel(const Tensor& tensor, int64_t index) {
  const int64_t channels = tensor.size(-1);
  std::vector<double> values;
  for (int64_t c = 0; c < channels; ++c) values.push_back(tensor.at(index * channels + c));
  return values;
}

void check_near(const std::vector<double>& got, const std::vector<double>& expected) {
  REQUIRE(got.size() == expected.size());
  for (size_t i = 0; i < got.size(); ++i) {
    INFO("channel " << i);
    CHECK(std::abs(got[i] - expected[i]) <= 2e-6);
  }
}

std::vector<double> triple(std::initializer_list<double> values) {
  std::vector<double> result;
  for (const double value : values) result.insert(result.end(), 3, value);
  return result;
}

constexpr int64_t kInside = 5;
constexpr int64_t kOutside = kSize - 1;

TEST_CASE("channels of the two variants", "[encode]") {
  CHECK(input_channels(EncodeOptions::paper()) == 19);
  CHECK(input_channels(EncodeOptions::release()) == 21);
  CHECK(illumination_values(EncodeOptions::paper()) == 28);
  CHECK(illumination_values(EncodeOptions::release()) == 27);
  CHECK(sss_values(EncodeOptions::paper()) == 7);
  CHECK(sss_values(EncodeOptions::release()) == 8);
  for (const char* name :
       {"intensity", "pol4", "maxmin", "dop_aop", "encoded_aop", "stokes", "mask", "background"}) {
    CHECK(to_string(parse_input_kind(name)) == name);
  }
  CHECK_THROWS_AS(parse_input_kind("pol5"), UsageError);
}

TEST_CASE("the paper's input: polarisers, max, min, mask", "[encode]") {
  const double s0 = 0.8;
  const double s1 = 0.3;
  const double s2 = -0.4;  // length 0.5
  const Scene scene = flat_scene(0.8F, 0.3F, -0.4F);
  const Sample sample = encode_scene(scene, EncodeOptions::paper());
  CHECK(sample.input.shape() == Shape{kSize, kSize, 19});
  std::vector<double> expected =
      triple({encoded((s0 + s1) / 2), encoded((s0 + s2) / 2), encoded((s0 - s1) / 2), encoded((s0 - s2) / 2),
              encoded((s0 + 0.5) / 2), encoded((s0 - 0.5) / 2)});
  expected.push_back(1);
  check_near(pixel(sample.input, kInside), expected);
  check_near(pixel(sample.input, kOutside), std::vector<double>(19, -1.0));
  CHECK(sample.mask.at(kInside) == 1);
  CHECK(sample.mask.at(kOutside) == 0);
}

TEST_CASE("the release's input: polarisers, background, min, max in 8 bits", "[encode]") {
  const auto truncated = [](double linear) {
    return 2 * std::floor(255 * std::pow(linear, 1 / 2.2)) / 255 - 1;
  };
  const Sample sample = encode_scene(flat_scene(0.8F, 0.3F, -0.4F), EncodeOptions::release());
  check_near(pixel(sample.input, kInside), triple({truncated(0.55), truncated(0.2), truncated(0.25),
                                                   truncated(0.6), -1, truncated(0.15), truncated(0.65)}));
  check_near(pixel(sample.input, kOutside), triple({-1, -1, -1, -1, truncated(0.55), -1, -1}));
}

TEST_CASE("raw inputs are not masked", "[encode]") {
  EncodeOptions options;
  options.inputs = {InputKind::kIntensity, InputKind::kDopAop, InputKind::kEncodedAop, InputKind::kStokes};
  const Sample sample = encode_scene(flat_scene(0.8F, 0.3F, -0.4F), options);
  const double aop = 0.5 * std::atan2(-0.4, 0.3) + std::numbers::pi;
  const std::vector<double> expected =
      triple({encoded(0.4), 0.5 / 0.8, aop, std::cos(2 * aop), std::sin(2 * aop), 0.8, 0.3, -0.4});
  check_near(pixel(sample.input, kInside), expected);
  check_near(pixel(sample.input, kOutside), expected);
}

TEST_CASE("images are clipped before Stokes, max and min are computed", "[encode]") {
  EncodeOptions options;
  options.inputs = {InputKind::kPol4, InputKind::kMaxMin, InputKind::kStokes};
  // I0 = 1.3, I90 = 0.3, I45 = I135 = 0.8; clipped: 1, 0.3, 0.8, 0.8.
  const Sample sample = encode_scene(flat_scene(1.6F, 1.0F, 0.0F), options);
  const double s0 = (1 + 0.3 + 1.6) / 2;
  const double s1 = 0.7;
  check_near(pixel(sample.input, kInside),
             triple({1, encoded(0.8), encoded(0.3), encoded(0.8), encoded((s0 + s1) / 2),
                     encoded((s0 - s1) / 2), s0, s1, 0}));
  // An exposure of one half lifts the clipping.
  const Sample dim = encode_scene(flat_scene(1.6F, 1.0F, 0.0F), options, {}, Shot::exposed(0.5F));
  check_near(pixel(dim.input, kInside), triple({encoded(0.65), encoded(0.4), encoded(0.15), encoded(0.4),
                                                encoded(0.65), encoded(0.15), 0.8, 0.5, 0}));
}

TEST_CASE("DoP and AoP are defined everywhere and AoP stays under pi", "[encode]") {
  EncodeOptions options;
  options.inputs = {InputKind::kDopAop, InputKind::kEncodedAop};
  check_near(pixel(encode_scene(flat_scene(0, 0, 0), options).input, 0), triple({0, 0, 1, 0}));
  check_near(pixel(encode_scene(flat_scene(1, 0, 0), options).input, 0), triple({0, 0, 1, 0}));
  const std::array<std::array<float, 2>, 5> directions = {
      {{0.3F, -1e-9F}, {-0.3F, -1e-9F}, {-0.3F, 0.0F}, {0.0F, -0.3F}, {0.3F, 0.1F}}};
  for (const auto& [s1, s2] : directions) {
    const double aop = encode_scene(flat_scene(1, s1, s2), options).input.at(3);
    CHECK(aop >= 0);
    CHECK(static_cast<float>(aop) < std::numbers::pi_v<float>);
  }
}

TEST_CASE("targets of the paper and of the release", "[encode]") {
  const Scene scene = flat_scene(0.8F, 0.3F, -0.4F);
  const Sample paper = encode_scene(scene, EncodeOptions::paper());
  check_near(pixel(paper.normal, kInside), {0.6, 0, 0.8});
  check_near(pixel(paper.normal, kOutside), {0, 0, 0});
  CHECK(paper.depth.at(kInside) == 0.25);
  CHECK(paper.depth.at(kOutside) == 0);
  REQUIRE(paper.illumination.shape() == Shape{28});
  CHECK(paper.illumination.at(26) == Approx(2.6));
  CHECK(paper.illumination.at(27) == Approx(0.0).margin(1e-6));  // 55 is the middle of 35 to 75
  check_near(pixel(paper.sss, 0), {0, -1, 0, 1, -1, 0, 1});
  const Sample release = encode_scene(scene, EncodeOptions::release());
  CHECK(release.illumination.shape() == Shape{27});
  check_near(pixel(release.sss, 0), {0, -1, 0, 1, -1, 0, 1, 0});
  // Images for the reconstruction: its input not masked, its target masked.
  CHECK(paper.bsdf.shape() == Shape{kSize, kSize, 12});
  check_near(pixel(paper.bsdf, kOutside), triple({encoded(0.2), encoded(0.2), encoded(0.2), encoded(0.2)}));
  const std::vector<double> input = pixel(paper.input, kInside);
  check_near(pixel(paper.polarised, kInside), {input.begin(), input.begin() + 12});
  check_near(pixel(paper.polarised, kOutside), std::vector<double>(12, -1.0));
}

TEST_CASE("what a scene lacks stays undefined", "[encode]") {
  Scene scene = flat_scene(0.8F, 0.3F, -0.4F);
  scene.flash.reset();
  scene.bsdf.clear();
  scene.normal.clear();
  const Sample paper = encode_scene(scene, EncodeOptions::paper());
  CHECK_FALSE(paper.illumination.defined());
  CHECK_FALSE(paper.bsdf.defined());
  CHECK_FALSE(paper.normal.defined());
  CHECK(paper.sss.defined());
  const Sample none =
      encode_scene(scene, EncodeOptions::release(), {.targets = false, .reconstruction = false});
  CHECK_FALSE(none.illumination.defined());
  CHECK_FALSE(none.polarised.defined());
}

TEST_CASE("the SSS map and its inverse agree", "[encode]") {
  Random random(3, Purpose::kTest);
  for (int trial = 0; trial < 100; ++trial) {
    const auto g = static_cast<float>(random.uniform(0, 0.9));
    const auto sigma_t = static_cast<float>(random.uniform(0, 32));
    const auto albedo = static_cast<float>(random.uniform(0.3, 0.95));
    const auto flash = static_cast<float>(random.uniform(35, 75));
    const std::vector<float> mapped = {map_g(g),          map_sigma_t(sigma_t), map_sigma_t(32.0F),
                                       map_sigma_t(0.0F), map_albedo(albedo),   map_albedo(0.3F),
                                       map_albedo(0.95F), map_flash(flash)};
    for (const float value : mapped) {
      REQUIRE(value >= -1.000001F);
      REQUIRE(value <= 1.000001F);
    }
    const SssValues values = decode_sss(mapped);
    CHECK(std::abs(values.g - g) <= 1e-6F);
    CHECK(std::abs(values.sigma_t[0] - sigma_t) <= 1e-5F);
    CHECK(values.sigma_t[1] == 32.0F);
    CHECK(std::abs(values.albedo[0] - albedo) <= 1e-6F);
    CHECK(std::abs(values.flash - flash) <= 1e-4F);
  }
  CHECK_THROWS_AS(decode_sss(std::vector<float>(6)), Error);
}

TEST_CASE("the gamma encoding and its inverse agree", "[encode]") {
  for (int i = 0; i <= 1000; ++i) {
    const float linear = static_cast<float>(i) / 1000;
    CHECK(std::abs(decode_gamma(encode_gamma(linear)) - linear) <= 1e-6F);
  }
  CHECK(encode_gamma(-1) == 0);
  CHECK(encode_gamma(7) == 1);
  CHECK(to_byte(0.5F) == 128);
  CHECK(to_byte(2.0F) == 255);
  CHECK(to_byte(-1.0F) == 0);
}

TEST_CASE("sizes that the networks cannot take are refused with a size that they can", "[encode]") {
  Scene scene = flat_scene(0.8F, 0.3F, -0.4F);
  scene.width = 250;
  scene.height = 17;
  const std::string message = message_of([&] { encode_scene(scene, EncodeOptions::paper()); });
  CHECK(contains(message, "scene flat has 250 x 17 pixels"));
  CHECK(contains(message, "crop or resize it to 240 x 32"));
}

TEST_CASE("batches stack their samples", "[encode]") {
  const Sample a = encode_scene(flat_scene(0.8F, 0.3F, -0.4F), EncodeOptions::paper());
  const Sample b = encode_scene(flat_scene(0.5F, 0.1F, 0.2F), EncodeOptions::paper());
  const std::vector<Sample> samples = {a, b};
  const Batch batch = make_batch(samples);
  CHECK(batch.size() == 2);
  CHECK(batch.input.shape() == Shape{2, kSize, kSize, 19});
  CHECK(batch.sss.shape() == Shape{2, 7});
  const int64_t half = batch.input.numel() / 2;
  for (int64_t i = 0; i < half; i += 101) {
    REQUIRE(batch.input.at(i) == a.input.at(i));
    REQUIRE(batch.input.at(half + i) == b.input.at(i));
  }
  std::vector<Sample> lacking = samples;
  lacking[1].depth = {};
  CHECK(contains(message_of([&] { make_batch(lacking); }), "only one has depth"));
}

}  // namespace
}  // namespace opaline::test
