// Small networks in float64 against PyTorch: outputs, every gradient and every updated buffer.
#include <algorithm>
#include <array>
#include <catch2/catch.hpp>
#include <cmath>
#include <string>
#include <string_view>

#include "core/autograd.h"
#include "core/ops/shape.h"
#include "core/safetensors.h"
#include "models/network.h"
#include "nn/pattern.h"

namespace opaline {
namespace {

using test::pattern;

// At width 4 the decoder's last hidden layer has one channel, and its ReLU may die.
NetworkOptions small_options(std::string_view name) {
  return {.image_size = 32, .width = name == "illumination_decoder" ? 16 : 4, .dtype = DType::kFloat64};
}
constexpr int64_t kColumns = 4;  // norm and three projections

std::array<double, kColumns> summary(const Tensor& tensor) {
  std::array<double, kColumns> result{};
  for (int64_t i = 0; i < tensor.numel(); ++i) {
    const double value = tensor.at(i);
    result[0] += value * value;
    for (uint64_t p = 0; p < 3; ++p) {
      result[p + 1] += value * pattern(static_cast<uint64_t>(i), test::kProbeTag + p);
    }
  }
  result[0] = std::sqrt(result[0]);
  for (size_t p = 1; p < kColumns; ++p) result[p] /= std::sqrt(static_cast<double>(tensor.numel()));
  return result;
}

Tensor inward(const Tensor& x) {
  return x.dim() == 4 ? to_nhwc(x) : x;
}
Tensor outward(const Tensor& x) {
  return x.dim() == 4 ? to_nchw(x) : x;
}

// Row `row` of `golden` against the tensor. The floor is for tensors that are zero in exact arithmetic.
void check_summary(const std::string& name, const Tensor& tensor, const Tensor& golden, int64_t row,
                   double floor) {
  const auto found = summary(tensor);
  const double tolerance = 1e-9 * golden.at(row * kColumns) + floor;
  for (int64_t column = 0; column < kColumns; ++column) {
    const double expected = golden.at(row * kColumns + column);
    const double error = std::abs(found[static_cast<size_t>(column)] - expected);
    INFO(name << " column " << column << ": " << found[static_cast<size_t>(column)] << ", expected "
              << expected);
    CHECK(error <= tolerance);
  }
}

// The golden sample is every eighth pixel of each plane.
void check_sample(const Tensor& y, const Tensor& sample) {
  const int64_t step = y.dim() == 4 ? 8 : 1;
  for (int64_t i = 0; i < sample.numel(); ++i) {
    int64_t index = i;
    if (y.dim() == 4) {
      const int64_t column = i % sample.size(3);
      const int64_t row = i / sample.size(3) % sample.size(2);
      const int64_t plane = i / (sample.size(3) * sample.size(2));
      index = (plane * y.size(2) + row * step) * y.size(3) + column * step;
    }
    INFO("sample " << i << ": " << y.at(index) << ", expected " << sample.at(i));
    REQUIRE(std::abs(y.at(index) - sample.at(i)) <= 1e-10);
  }
}

void check_network(const std::string& name, const std::string& mode) {
  const TensorMap golden =
      load_safetensors(std::string(OPALINE_TEST_DATA) + "/" + name + ".safetensors").tensors;
  const auto network = make_network(name, small_options(name));
  test::set_pattern_state(*network);
  network->set_training(mode == "train");

  Shape shape;
  for (const int64_t size : golden.at(mode + ".shape").values<int64_t>()) shape.push_back(size);
  Tensor x = inward(test::pattern_tensor(shape, test::kInputTag));
  x.set_requires_grad(true);
  const Tensor y = network->forward(x);
  const Tensor y_outward = outward(y.detach());
  check_summary("y", y_outward, golden.at(mode + ".y"), 0, 0.0);
  check_sample(y_outward, golden.at(mode + ".y_sample"));

  backward(y, inward(test::pattern_tensor(y_outward.shape(), test::kCotangentTag)));
  const Tensor& gradients = golden.at(mode + ".gradients");
  const auto parameters = network->named_parameters();
  REQUIRE(gradients.size(0) == static_cast<int64_t>(parameters.size()) + 1);
  double largest = 0.0;
  for (int64_t row = 0; row < gradients.size(0); ++row) {
    largest = std::max(largest, gradients.at(row * kColumns));
  }
  check_summary("x", outward(x.grad()), gradients, 0, 0.0);
  for (size_t i = 0; i < parameters.size(); ++i) {
    check_summary(parameters[i].name, parameters[i].tensor.grad(), gradients, static_cast<int64_t>(i) + 1,
                  1e-11 * largest);
  }

  if (mode != "train") return;
  const auto buffers = network->named_buffers();
  REQUIRE(golden.at("train.buffers").size(0) == static_cast<int64_t>(buffers.size()));
  for (size_t i = 0; i < buffers.size(); ++i) {
    check_summary(buffers[i].name, buffers[i].tensor, golden.at("train.buffers"), static_cast<int64_t>(i),
                  0.0);
  }
}

TEST_CASE("small networks agree with PyTorch in float64") {
  for (const std::string_view name : kNetworkNames) {
    for (const std::string mode : {"train", "eval"}) {
      DYNAMIC_SECTION(name << " " << mode) {
        check_network(std::string(name), mode);
      }
    }
  }
}

}  // namespace
}  // namespace opaline
