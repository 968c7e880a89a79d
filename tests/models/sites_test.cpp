// Networks on a part of their images: what skipping may and may not change.
#include <catch2/catch.hpp>
#include <cmath>
#include <cstring>

#include "core/autograd.h"
#include "core/ops/sites.h"
#include "core/parallel.h"
#include "models/check.h"
#include "nn/pattern.h"

namespace opaline {
namespace {

using Sites = std::shared_ptr<const ActiveSites>;

constexpr int64_t kSize = 32;
constexpr std::string_view kSkipping[] = {"normal", "depth", "sss", "reconstruction"};

/// Pixels of images of 32 x 32 by a rule of (image, row, column).
template <class F>
Sites sites_where(int64_t n, const F& active) {
  std::vector<uint8_t> flags;
  for (int64_t i = 0; i < n * kSize * kSize; ++i) {
    flags.push_back(active(i / (kSize * kSize), i / kSize % kSize, i % kSize) ? 1 : 0);
  }
  return std::make_shared<const ActiveSites>(n, kSize, kSize, flags);
}

bool same_bits(const Tensor& a, const Tensor& b) {
  return a.numel() == b.numel() && a.dtype() == b.dtype() &&
         std::memcmp(a.bytes(), b.bytes(), static_cast<size_t>(a.byte_size())) == 0;
}

/// Output, gradients and statistics of one step of a network.
std::vector<Tensor> step(std::string_view name, int64_t batch, const Sites& sites, double absent = 0.0) {
  NetworkOptions options = small_network_options(name);
  options.dtype = DType::kFloat32;
  const auto network = make_network(name, options);
  test::set_pattern_state(*network);
  Tensor x = test::pattern_tensor(network_input_shape(name, batch, options), test::kInputTag, 1.0, 0.0,
                                  DType::kFloat32);
  if (absent != 0.0) {
    Tensor changed = to_dense(select_sites(x, sites), absent);
    x = changed;
  }
  x.set_requires_grad(true);
  const Tensor y = network->forward(sites ? select_sites(x, sites) : x);
  backward(y, test::pattern_tensor(y.shape(), test::kCotangentTag, 1.0, 0.0, DType::kFloat32));
  std::vector<Tensor> results{y.detach(), x.grad()};
  for (const NamedTensor& parameter : network->named_parameters()) {
    results.push_back(parameter.tensor.grad());
  }
  for (const NamedTensor& buffer : network->named_buffers()) results.push_back(buffer.tensor);
  return results;
}

TEST_CASE("a full mask gives the network of whole images to the last bit") {
  const Sites full = sites_where(4, [](int64_t, int64_t, int64_t) { return true; });
  for (const std::string_view name : kSkipping) {
    const auto dense = step(name, 4, nullptr), sparse = step(name, 4, full);
    REQUIRE(dense.size() == sparse.size());
    for (size_t i = 0; i < dense.size(); ++i) {
      INFO(name << " tensor " << i);
      CHECK(same_bits(dense[i], sparse[i]));
    }
  }
}

TEST_CASE("gradients of networks on active sites are those of difference quotients") {
  const ThreadsGuard one_thread(1);
  const std::pair<std::string, Sites> masks[] = {
      // Tiles of 16 pixels: three, one, and all.
      {"tiles", sites_where(3,
                            [](int64_t n, int64_t i, int64_t j) {
                              const bool low = i >= 16, right = j >= 16;
                              return n == 0 ? !(low && right) : n == 1 ? low && right : true;
                            })},
      {"holes",
       sites_where(4, [](int64_t n, int64_t i, int64_t j) { return (i / 3 * 5 + j / 2 + n) % 3 != 0; })},
      {"islands", sites_where(4,
                              [](int64_t n, int64_t i, int64_t j) {
                                return (i - 8) * (i - 8) + (j - 9) * (j - 9) < 20 + n ||
                                       (i > 24 && j > 20 + n) || (i == 0 && j == 31);
                              })},
      {"an empty image",
       sites_where(4, [](int64_t n, int64_t i, int64_t j) { return n != 1 && i + j > 20; })},
  };
  for (const auto& [mask, sites] : masks) {
    for (const std::string_view name : {"normal", "sss"}) {
      for (const check::GradientError& leaf : network_gradient_errors(name, true, {}, sites)) {
        INFO(mask << ", " << name << " " << leaf.name << ": relative error " << leaf.error << ", norm "
                  << leaf.norm);
        CHECK(leaf.error <= 1e-6);
      }
    }
  }
}

TEST_CASE("nothing that stands at an absent pixel reaches a result") {
  const Sites sites =
      sites_where(4, [](int64_t n, int64_t i, int64_t j) { return i / 16 == n % 2 || j < 16; });
  for (const std::string_view name : kSkipping) {
    const auto one = step(name, 4, sites);
    const auto other = step(name, 4, sites, std::nan(""));
    for (size_t i = 0; i < one.size(); ++i) {
      INFO(name << " tensor " << i);
      CHECK(same_bits(one[i], other[i]));
    }
  }
}

TEST_CASE("images of different coverage share a batch, each as if it were alone") {
  const Sites both =
      sites_where(2, [](int64_t n, int64_t i, int64_t j) { return n == 0 ? i < 16 : j < 16 || i < 16; });
  const Sites first = sites_where(1, [](int64_t, int64_t i, int64_t) { return i < 16; });
  NetworkOptions options = small_network_options("normal");
  const auto network = make_network("normal", options);
  test::set_pattern_state(*network);
  network->set_training(false);
  const NoGradGuard no_grad;
  const Tensor x = test::pattern_tensor(network_input_shape("normal", 2, options), test::kInputTag);
  const Tensor alone = test::pattern_tensor(network_input_shape("normal", 1, options), test::kInputTag);
  const Tensor joint = network->forward(select_sites(x, both));
  const Tensor single = network->forward(select_sites(alone, first));
  REQUIRE(single.size(0) == both->first(1));
  for (int64_t i = 0; i < single.numel(); ++i) REQUIRE(joint.at(i) == Approx(single.at(i)).epsilon(1e-9));
}

TEST_CASE("networks on active sites give the same bits for any number of threads") {
  const Sites sites =
      sites_where(4, [](int64_t n, int64_t i, int64_t j) { return (i / 16 + j / 16 + n) % 3 != 0; });
  for (const std::string_view name : {"normal", "sss"}) {
    std::vector<Tensor> one, three;
    {
      const ThreadsGuard threads(1);
      one = step(name, 4, sites);
    }
    {
      const ThreadsGuard threads(3);
      three = step(name, 4, sites);
    }
    for (size_t i = 0; i < one.size(); ++i) CHECK(same_bits(one[i], three[i]));
  }
}

TEST_CASE("the illumination network needs whole images") {
  const Sites sites = sites_where(2, [](int64_t, int64_t i, int64_t) { return i < 16; });
  const NetworkOptions options = small_network_options("illumination");
  const auto network = make_network("illumination", options);
  const Tensor x = test::pattern_tensor(network_input_shape("illumination", 2, options), test::kInputTag);
  CHECK_THROWS_WITH(network->forward(select_sites(x, sites)), Catch::Contains("whole images"));
}

}  // namespace
}  // namespace opaline
