// Charts, pictures and evaluation against values worked out by hand.
#include <catch2/catch.hpp>
#include <cstring>

#include "core/error.h"
#include "tests/train/synthetic.h"
#include "train/chart.h"
#include "train/evaluate.h"
#include "train/picture.h"
#include "train/progress.h"

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

TEST_CASE("durations read well") {
  CHECK(format_duration(42.4) == "42 s");
  CHECK(format_duration(190) == "3 min 10 s");
  CHECK(format_duration(7500) == "2 h 5 min");
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

}  // namespace
}  // namespace opaline
