// Names, shapes and order of the state dicts; sizes, options and errors of the networks.
#include <catch2/catch.hpp>
#include <cstring>
#include <fstream>
#include <map>
#include <string>
#include <vector>

#include "core/autograd.h"
#include "core/parallel.h"
#include "models/network.h"
#include "nn/pattern.h"

namespace opaline {
namespace {

// "name (64, 21, 3, 3) float32" for each line of a network's section in the reference list.
std::vector<std::string> reference_lines(const std::string& heading) {
  std::ifstream file(std::string(OPALINE_TEST_DATA) + "/state_dict_names.txt");
  std::vector<std::string> lines;
  bool inside = false;
  for (std::string line; std::getline(file, line);) {
    if (line.starts_with("## ")) {
      inside = line.starts_with("## " + heading + " ");
    } else if (inside && !line.empty()) {
      lines.push_back(line);
    }
  }
  return lines;
}

std::string python_shape(const Shape& shape) {
  return fmt::format("({}{})", fmt::join(shape, ", "), shape.size() == 1 ? "," : "");
}

std::vector<std::string> our_lines(const Network& network) {
  std::vector<std::string> lines;
  for (const NamedTensor& entry : network.named_state()) {
    lines.push_back(fmt::format("{} {} {}", entry.name, python_shape(entry.tensor.shape()),
                                to_string(entry.tensor.dtype())));
  }
  return lines;
}

constexpr NetworkOptions kSmall{.image_size = 32, .width = 4};

Shape input_shape(std::string_view name, int64_t batch, int64_t size, const NetworkOptions& options) {
  if (name == "illumination_decoder") return {batch, illumination_values(options.variant)};
  if (name == "sss") return {batch, size, size, 5 + options.input_channels};
  if (name == "reconstruction") return {batch, size, size, kBsdfChannels + sss_values(options.variant)};
  return {batch, size, size, options.input_channels};
}

struct Released {
  std::string name, heading;
  int64_t parameters;
};

TEST_CASE("state dicts have the released names, shapes, types and order") {
  for (const auto& [name, heading, parameters] : std::vector<Released>{
           {"normal", "Normal", 42491331},
           {"illumination", "IlluminationEncoder", 15771921},
           {"illumination_decoder", "IlluminationDecoder", 11628770},
           {"sss", "SSS", 18661272},
       }) {
    DYNAMIC_SECTION(name) {
      const auto expected = reference_lines(heading);
      REQUIRE_FALSE(expected.empty());
      const auto network = make_network(name);
      CHECK(our_lines(*network) == expected);
      CHECK(network->parameter_count() == parameters);
    }
  }
}

TEST_CASE("depth and reconstruction differ from normal in the first and last layer only") {
  const auto normal = our_lines(*make_network("normal"));
  const std::map<std::string, std::vector<std::string>> differing = {
      {"depth", {"outc.conv.weight (1, 64, 1, 1) float32", "outc.conv.bias (1,) float32"}},
      {"reconstruction",
       {"inc.double_conv.0.weight (64, 20, 3, 3) float32", "outc.conv.weight (12, 64, 1, 1) float32",
        "outc.conv.bias (12,) float32"}}};
  for (const auto& [name, expected] : differing) {
    const auto lines = our_lines(*make_network(name));
    REQUIRE(lines.size() == normal.size());
    std::vector<std::string> found;
    for (size_t i = 0; i < lines.size(); ++i) {
      if (lines[i] != normal[i]) found.push_back(lines[i]);
    }
    CHECK(found == expected);
  }
}

TEST_CASE("outputs have the sizes of their variant at any run-time size") {
  const std::map<std::string_view, int64_t> paper = {{"normal", 3},          {"depth", 1},
                                                     {"illumination", 28},   {"sss", 7},
                                                     {"reconstruction", 12}, {"illumination_decoder", 1}};
  const std::map<std::string_view, int64_t> release = {{"normal", 3},          {"depth", 1},
                                                       {"illumination", 27},   {"sss", 8},
                                                       {"reconstruction", 12}, {"illumination_decoder", 1}};
  const NoGradGuard no_grad;
  for (const Variant variant : {Variant::kPaper, Variant::kRelease}) {
    const bool is_paper = variant == Variant::kPaper;
    NetworkOptions options = kSmall;
    options.variant = variant;
    options.input_channels = is_paper ? 19 : 21;
    for (const std::string_view name : kNetworkNames) {
      const auto network = make_network(name, options);
      test::set_pattern_state(*network);
      for (const int64_t size : {32, 48}) {
        const Tensor x = test::pattern_tensor(input_shape(name, 2, size, options), test::kInputTag, 1.0, 0.0,
                                              DType::kFloat32);
        const Tensor y = network->forward(x);
        const int64_t channels = (is_paper ? paper : release).at(name);
        INFO(name << " at " << size);
        if (name == "illumination" || name == "sss") {
          CHECK(y.shape() == Shape{2, channels});
        } else if (name == "illumination_decoder") {
          CHECK(y.shape() == Shape{2, 32, 32, 1});
        } else {
          CHECK(y.shape() == Shape{2, size, size, channels});
        }
      }
    }
  }
}

TEST_CASE("the illumination decoder doubles up to the power of two at or over the build size, at most 256") {
  const NoGradGuard no_grad;
  for (const auto& [size, map] : std::map<int64_t, int64_t>{{32, 32}, {48, 64}, {64, 64}, {512, 256}}) {
    const auto network = make_network("illumination_decoder", {.image_size = size, .width = 4});
    CHECK(network->forward(Tensor::zeros({2, 27})).shape() == Shape{2, map, map, 1});
  }
}

TEST_CASE("bad names, options and inputs are named") {
  using Catch::Contains;
  CHECK_THROWS_WITH(make_network("normals"),
                    Contains("no network 'normals'") && Contains("illumination_decoder"));
  CHECK_THROWS_AS(make_network("normals"), UsageError);
  CHECK_THROWS_WITH(make_network("sss", {.image_size = 40}), Contains("image_size 40"));
  CHECK_THROWS_WITH(make_network("sss", {.image_size = 16}), Contains("at least 32"));
  CHECK_THROWS_WITH(make_network("sss", {.width = 6}), Contains("width 6") && Contains("multiple of 4"));
  CHECK_THROWS_WITH(make_network("normal", {.input_channels = 0}), Contains("input channels, got 0"));

  const auto normal = make_network("normal", kSmall);
  CHECK_THROWS_WITH(normal->forward(Tensor::zeros({1, 32, 32, 20})),
                    Contains("[normal]") && Contains("1x32x32x20") && Contains("N x H x W x 21"));
  CHECK_THROWS_WITH(normal->forward(Tensor::zeros({1, 32, 40, 21})), Contains("32 x 40"));
  CHECK_THROWS_WITH(make_network("illumination_decoder", kSmall)->forward(Tensor::zeros({2, 28})),
                    Contains("2x28") && Contains("N x 27"));
}

TEST_CASE("a vector head cannot train on one sample, but evaluates it") {
  for (const std::string_view name : {"illumination", "sss"}) {
    const auto network = make_network(name, kSmall);
    initialize_network(*network, name, 1);
    const Tensor x =
        test::pattern_tensor(input_shape(name, 1, 32, kSmall), test::kInputTag, 1.0, 0.0, DType::kFloat32);
    CHECK_THROWS_WITH(network->forward(x), Catch::Contains("single sample"));
    network->set_training(false);
    CHECK(network->forward(x).size(0) == 1);
  }
}

TEST_CASE("initial weights depend on the seed and the network alone") {
  const auto weights = [](std::string_view name, uint64_t seed, DType dtype = DType::kFloat32) {
    NetworkOptions options = kSmall;
    options.dtype = dtype;
    const auto network = make_network(name, options);
    initialize_network(*network, name, seed);
    return network->state_dict().at("down1.maxpool_conv.1.double_conv.0.weight").clone();
  };
  const auto equal = [](const Tensor& a, const Tensor& b) {
    return std::memcmp(a.bytes(), b.bytes(), static_cast<size_t>(a.byte_size())) == 0;
  };
  CHECK(equal(weights("normal", 1), weights("normal", 1)));
  CHECK_FALSE(equal(weights("normal", 1), weights("normal", 2)));
  CHECK_FALSE(equal(weights("normal", 1), weights("depth", 1)));
  CHECK(equal(weights("normal", 1), weights("normal", 1, DType::kFloat64).to(DType::kFloat32)));
}

// Every result of a training pass: output, gradients, running statistics.
std::vector<Tensor> training_pass(std::string_view name, int threads) {
  const int before = num_threads();
  set_num_threads(threads);
  NetworkOptions options = kSmall;
  options.width = 8;
  const auto network = make_network(name, options);
  test::set_pattern_state(*network);
  Tensor x =
      test::pattern_tensor(input_shape(name, 3, 48, options), test::kInputTag, 1.0, 0.0, DType::kFloat32);
  x.set_requires_grad(true);
  const Tensor y = network->forward(x);
  backward(y, test::pattern_tensor(y.shape(), test::kCotangentTag, 1.0, 0.0, DType::kFloat32));
  set_num_threads(before);
  std::vector<Tensor> results = {y.detach(), x.grad()};
  for (const NamedTensor& parameter : network->named_parameters()) results.push_back(parameter.tensor.grad());
  for (const NamedTensor& buffer : network->named_buffers()) results.push_back(buffer.tensor);
  return results;
}

TEST_CASE("a training pass gives the same bits for any number of threads") {
  for (const std::string_view name : kNetworkNames) {
    const auto one = training_pass(name, 1);
    for (const int threads : {2, 3}) {
      const auto many = training_pass(name, threads);
      REQUIRE(many.size() == one.size());
      for (size_t i = 0; i < one.size(); ++i) {
        INFO(name << " tensor " << i << " with " << threads << " threads");
        REQUIRE(std::memcmp(one[i].bytes(), many[i].bytes(), static_cast<size_t>(one[i].byte_size())) == 0);
      }
    }
  }
}

}  // namespace
}  // namespace opaline
