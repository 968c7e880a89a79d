// Charts, pictures and evaluation against values worked out by hand.
#include <algorithm>
#include <catch2/catch.hpp>
#include <cmath>
#include <cstring>
#include <thread>

#include "core/autograd.h"
#include "core/error.h"
#include "core/progress.h"
#include "data/chart.h"
#include "data/picture.h"
#include "tests/train/synthetic.h"
#include "train/evaluate.h"

namespace opaline {
namespace {

using Catch::Matchers::Contains;

TEST_CASE("base64 follows RFC 4648") {
  const auto encode = [](std::string_view text) { return base64(std::as_bytes(std::span(text))); };
  CHECK(encode("") == "");
  CHECK(encode("f") == "Zg==");
  CHECK(encode("fo") == "Zm8=");
  CHECK(encode("foo") == "Zm9v");
  CHECK(encode("foobar") == "Zm9vYmFy");
}

TEST_CASE("pictures of maps") {
  const std::vector<float> normal = {0, 0, 2, 1, 0, 0};
  const std::vector<uint8_t> mask = {1, 0};
  const Picture picture = picture_of_normals({.values = normal, .mask = mask, .width = 2, .height = 1});
  CHECK(picture.rgb == std::vector<uint8_t>{128, 128, 255, 0, 0, 0});
  const std::vector<float> depth = {3, 9};
  const ValueRange range = range_inside({.values = depth, .mask = mask, .width = 2, .height = 1});
  CHECK(range.low == 3.0F);
  CHECK(range.high == 3.0F);
  CHECK(picture_of_depth({.values = depth, .mask = mask, .width = 2, .height = 1}, 3, 3).rgb[0] == 255);
  CHECK_THAT(data_uri(picture), Catch::Matchers::StartsWith("data:image/png;base64,iVBORw0KGgo"));
}

TEST_CASE("charts hold their points and nothing that is not finite") {
  const std::string svg =
      render_chart({{.name = "a<b", .colour = "#123", .points = {{0, 1}, {1, NAN}, {2, 10}}},
                    {.name = "other", .colour = "#456", .points = {{0, 0}, {1, 5}}}},
                   {.title = "Loss & more", .x_label = "step", .log_y = true});
  CHECK_THAT(svg, Contains("Loss &amp; more") && Contains("a&lt;b") && Contains("</svg>"));
  CHECK_THAT(svg, !Contains("nan") && !Contains("inf"));
  CHECK_THAT(render_chart({}, {.title = "empty"}), Contains("no points yet"));
  // One constant value has a range of its own.
  CHECK_THAT(render_chart({{.name = "c", .colour = "red", .points = {{1, 4}}}}, {}), !Contains("nan"));
}

TEST_CASE("a chart mixes lines and dots") {
  const auto count = [](const std::string& svg, std::string_view what) {
    int found = 0;
    for (size_t at = svg.find(what); at != std::string::npos; at = svg.find(what, at + 1)) ++found;
    return found;
  };
  const std::vector<ChartSeries> series = {
      {.name = "roof", .colour = "red", .points = {{1, 1}, {2, 4}}},
      {.name = "dots", .colour = "blue", .points = {{1, 2}, {2, 3}, {3, 4}}, .line = false}};
  const std::string mixed = render_chart(series, {});
  CHECK(count(mixed, "<polyline") == 1);
  CHECK(count(mixed, "<circle") == 3);
  CHECK(count(mixed, "fill='blue'") == 3);
  const std::string scatter = render_chart(series, {.lines = false});
  CHECK(count(scatter, "<polyline") == 0);
  CHECK(count(scatter, "<circle") == 5);
}

TEST_CASE("durations read well") {
  CHECK(format_duration(42.4) == "42 s");
  CHECK(format_duration(190) == "3 min 10 s");
  CHECK(format_duration(7500) == "2 h 5 min");
}

TEST_CASE("the time left counts all units alike where they differ in cost") {
  Progress progress({.quiet = true});
  progress.start(10, 14, {.items = "scenes", .all_units = true});
  for (const int milliseconds : {40, 0, 0}) {
    std::this_thread::sleep_for(std::chrono::milliseconds(milliseconds));
    progress.advance(1, "");
  }
  // Three units in 40 ms or more: one is left, and neither the slow nor the quick ones alone tell its time.
  CHECK(progress.seconds_left() > 0.012);
  CHECK(progress.seconds_left() < 0.2);
  CHECK(progress.rate() > 5);
  CHECK(progress.rate() < 80);
}

TEST_CASE("the mean predictor is the mean of the training scenes") {
  const test::SyntheticDataset dataset({.train = 3, .test = 2});
  const MeanPredictor mean = fit_mean_predictor(dataset);
  const size_t middle = 32 * 16 + 16;  // covered by every sphere
  double g = 0.0, depth = 0.0;
  std::array<double, 3> n{};
  for (int64_t i = 0; i < 3; ++i) {
    const Scene scene = dataset.load(Split::kTrain, i, {});
    REQUIRE(scene.mask[middle] == 1);
    g += *scene.g / 3.0;
    depth += scene.depth[middle] / 3.0;
    for (size_t c = 0; c < 3; ++c) n[c] += scene.normal[3 * middle + c];
  }
  const double length = std::sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
  CHECK(mean.depth[middle] == Approx(depth));
  CHECK(mean.sss->g == Approx(g));
  CHECK(mean.normal[3 * middle] == Approx(n[0] / length).margin(1e-6));
  CHECK(mean.normal[2] == 1.0F);  // a corner that no sphere covers
}

TEST_CASE("evaluation does not depend on the batch, and its JSON has the contract's keys") {
  const auto dataset =
      std::make_shared<test::SyntheticDataset>(test::SyntheticOptions{.train = 3, .test = 5});
  const MeanPredictor mean = fit_mean_predictor(*dataset);
  Cascade cascade(
      {.network = {.variant = Variant::kPaper, .input_channels = 19, .image_size = 32, .width = 4},
       .stage = 2,
       .reconstruction = false});
  cascade.initialize(1);
  const auto one = evaluate(cascade, dataset, EncodeOptions::paper(), &mean, {.batch = 1});
  const auto four = evaluate(cascade, dataset, EncodeOptions::paper(), &mean, {.batch = 4});
  REQUIRE(one.size() == 5);
  REQUIRE(four.size() == 5);
  for (size_t i = 0; i < one.size(); ++i) {
    CHECK(one[i].id == four[i].id);
    for (size_t m = 0; m < kMetricCount; ++m)
      CHECK(*one[i].cascade[m] == Approx(*four[i].cascade[m]).epsilon(1e-4));
  }
  const auto json = to_json(summarize(one));
  CHECK(json.at("n") == 5);
  for (const char* const key : {"normal", "depth", "sigma_t", "albedo", "g"}) {
    CHECK(json.at("release").at(key).is_number());
    CHECK(json.at("mean_predictor").at("release").at(key).is_number());
    CHECK(json.at("ci95").at("release").at(key).size() == 2);
  }
  for (const char* const key : {"angular_degrees", "depth_aligned"}) {
    CHECK(json.at(key).is_number());
    CHECK(json.at("mean_predictor").at(key).is_number());
    CHECK(json.at("ci95").at(key)[0] <= json.at(key));
  }
  CHECK_THAT(format_table(summarize(one)), Contains("training mean") && Contains("5 scenes"));
}

TEST_CASE("columns that were not asked for are neither measured nor computed") {
  const auto dataset =
      std::make_shared<test::SyntheticDataset>(test::SyntheticOptions{.train = 2, .test = 3});
  const MeanPredictor mean = fit_mean_predictor(*dataset);
  Cascade cascade(
      {.network = {.variant = Variant::kPaper, .input_channels = 19, .image_size = 32, .width = 4},
       .stage = 2,
       .reconstruction = false});
  cascade.initialize(1);
  const EvaluationSummary all = summarize(evaluate(cascade, dataset, EncodeOptions::paper(), &mean));
  // Networks that must not run would give numbers that are none, and end the evaluation.
  for (const char* name : {"depth", "illumination", "illumination_decoder", "sss"}) {
    for (const NamedTensor& parameter : cascade.network(name).named_parameters()) {
      Tensor values = parameter.tensor;
      values.fill(std::numeric_limits<double>::quiet_NaN());
    }
  }
  CHECK_THROWS_AS(evaluate(cascade, dataset, EncodeOptions::paper(), &mean), Error);
  const std::vector<std::string> names = {"normal"};
  const EvaluationSummary normal =
      summarize(evaluate(cascade, dataset, EncodeOptions::paper(), &mean, {.columns = parse_columns(names)}));
  for (size_t m = 0; m < kMetricCount; ++m) {
    const bool asked = kMetricNames[m] == "normal" || kMetricNames[m] == "angular_degrees";
    INFO(kMetricNames[m]);
    CHECK(normal.cascade[m] == (asked ? all.cascade[m] : std::nullopt));
    CHECK(normal.mean_predictor[m] == (asked ? all.mean_predictor[m] : std::nullopt));
  }
  CHECK(to_json(normal).at("depth_aligned").is_null());
  const std::vector<std::string> wrong = {"albedo"};
  CHECK_THROWS_WITH(parse_columns(wrong), Contains("albedo") && Contains("sss"));
}

TEST_CASE("evaluation on sensor images is another, the same every time; damaged scenes may be left out") {
  const auto dataset =
      std::make_shared<test::SyntheticDataset>(test::SyntheticOptions{.train = 4, .test = 4, .damaged = 2});
  CHECK_THROWS_AS(fit_mean_predictor(*dataset), Error);
  const MeanPredictor mean = fit_mean_predictor(*dataset, 0, DamagePolicy::kSkip);
  Cascade cascade(
      {.network = {.variant = Variant::kPaper, .input_channels = 19, .image_size = 32, .width = 4},
       .stage = 2,
       .reconstruction = false});
  cascade.initialize(1);
  EvaluateOptions options{.batch = 2};
  CHECK_THROWS_AS(evaluate(cascade, dataset, EncodeOptions::paper(), &mean, options), Error);
  std::vector<std::string> warnings;
  options.damaged = DamagePolicy::kSkip;
  options.warn = [&](std::string_view line) { warnings.emplace_back(line); };
  const auto clean = evaluate(cascade, dataset, EncodeOptions::paper(), &mean, options);
  REQUIRE(clean.size() == 3);
  CHECK(clean[2].id == "test-3");
  REQUIRE(warnings.size() == 1);
  CHECK_THAT(warnings[0], Contains("test-2") && Contains("the file ends early"));
  options.capture.sensor.on = true;
  const auto sensor = evaluate(cascade, dataset, EncodeOptions::paper(), &mean, options);
  options.batch = 1;
  const auto again = evaluate(cascade, dataset, EncodeOptions::paper(), &mean, options);
  REQUIRE(sensor.size() == 3);
  for (size_t i = 0; i < sensor.size(); ++i) {
    CHECK(*sensor[i].cascade[0] != *clean[i].cascade[0]);
    CHECK(*sensor[i].cascade[0] == Approx(*clean[i].cascade[0]).epsilon(0.2));
    CHECK(*sensor[i].cascade[0] == Approx(*again[i].cascade[0]).epsilon(1e-4));
    CHECK(sensor[i].mean == clean[i].mean);
  }
}

TEST_CASE("the numbers of one scene are those that its maps give by hand") {
  const Skip skip = GENERATE(Skip::kNone, Skip::kSupport);
  const auto dataset =
      std::make_shared<test::SyntheticDataset>(test::SyntheticOptions{.train = 1, .test = 1, .size = 64});
  const MeanPredictor mean = fit_mean_predictor(*dataset);
  Cascade cascade(
      {.network = {.variant = Variant::kPaper, .input_channels = 19, .image_size = 32, .width = 4},
       .stage = 2,
       .reconstruction = false,
       .skip = skip});
  cascade.initialize(3);
  const EvaluationSummary summary =
      summarize(evaluate(cascade, dataset, EncodeOptions::paper(), &mean, {.batch = 1}));
  REQUIRE(summary.n == 1);

  const Scene scene = dataset->load(Split::kTest, 0, {});
  const Scene train = dataset->load(Split::kTrain, 0, {});
  const Sample sample = encode_scene(scene, EncodeOptions::paper());
  const NoGradGuard no_grad;
  const Batch batch = make_batch({&sample, 1});
  const CascadeOutput out =
      whole(cascade.forward({.image = batch.input, .bsdf = {}, .mask = batch.mask}, {}));
  const std::span<const float> n = std::as_const(out.normal).values<float>();
  const std::span<const float> d = std::as_const(out.depth).values<float>();
  const std::span<const float> p = std::as_const(out.sss).values<float>();

  double pixels = 0, normal = 0, angle = 0, depth = 0, mean_normal = 0, mean_angle = 0;
  double low = 1e9, high = -1e9, true_low = 1e9, true_high = -1e9;
  for (size_t i = 0; i < scene.mask.size(); ++i) {
    if (scene.mask[i] == 0) continue;
    low = std::min<double>(low, d[i]);
    high = std::max<double>(high, d[i]);
    true_low = std::min<double>(true_low, scene.depth[i]);
    true_high = std::max<double>(true_high, scene.depth[i]);
  }
  for (size_t i = 0; i < scene.mask.size(); ++i) {
    if (scene.mask[i] == 0) continue;
    pixels += 1;
    double dot = 0, length = 0, mean_dot = 0;
    for (size_t c = 0; c < 3; ++c) {
      const double truth = scene.normal[3 * i + c];
      // With one training scene its map is the mean; where it has no object, the normal faces the camera.
      const double other = train.mask[i] != 0 ? train.normal[3 * i + c] : (c == 2 ? 1.0 : 0.0);
      normal += std::abs((n[3 * i + c] + 1) / 2 - (truth + 1) / 2) / 3;
      mean_normal += std::abs(other - truth) / 2 / 3;
      dot += n[3 * i + c] * truth;
      length += n[3 * i + c] * n[3 * i + c];
      mean_dot += other * truth;
    }
    // Four channels may all be rectified to zero, and so the normal.
    angle += length > 0 ? std::acos(std::clamp(dot / std::sqrt(length), -1.0, 1.0)) * 180 / M_PI : 90.0;
    mean_angle += std::acos(std::clamp(mean_dot, -1.0, 1.0)) * 180 / M_PI;
    depth += std::abs((d[i] - low) / (high - low) - (scene.depth[i] - true_low) / (true_high - true_low));
  }
  double sigma_t = 0, albedo = 0, mean_sigma_t = 0, mean_albedo = 0;
  for (size_t c = 0; c < 3; ++c) {
    sigma_t += std::abs((p[1 + c] + 1) / 2 - (*scene.sigma_t)[c] / 32) / 3;
    albedo += std::abs(0.3 + 0.65 * (p[4 + c] + 1) / 2 - (*scene.albedo)[c]) / 3;
    mean_sigma_t += std::abs((*train.sigma_t)[c] - (*scene.sigma_t)[c]) / 32 / 3;
    mean_albedo += std::abs((*train.albedo)[c] - (*scene.albedo)[c]) / 3;
  }
  const double g = std::abs(0.9 * (p[0] + 1) / 2 - *scene.g);

  const auto json = to_json(summary);
  const auto release = json.at("release");
  const auto mean_of = json.at("mean_predictor");
  const auto near = [](double value) { return Approx(value).epsilon(1e-4); };
  CHECK(release.at("normal").get<double>() == near(normal / pixels));
  CHECK(release.at("depth").get<double>() == near(depth / pixels));
  CHECK(release.at("sigma_t").get<double>() == near(sigma_t));
  CHECK(release.at("albedo").get<double>() == near(albedo));
  CHECK(release.at("g").get<double>() == near(g));
  CHECK(json.at("angular_degrees").get<double>() == near(angle / pixels));
  CHECK(mean_of.at("release").at("normal").get<double>() == near(mean_normal / pixels));
  CHECK(mean_of.at("release").at("sigma_t").get<double>() == near(mean_sigma_t));
  CHECK(mean_of.at("release").at("albedo").get<double>() == near(mean_albedo));
  CHECK(mean_of.at("release").at("g").get<double>() == near(std::abs(*train.g - *scene.g)));
  CHECK(mean_of.at("angular_degrees").get<double>() == Approx(mean_angle / pixels).epsilon(1e-3));
}

}  // namespace
}  // namespace opaline
