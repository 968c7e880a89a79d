// Whole networks in float64: backward against difference quotients of the forward pass.
#include <catch2/catch.hpp>
#include <string_view>

#include "core/parallel.h"
#include "models/check.h"

namespace opaline {
namespace {

constexpr double kTolerance = 1e-6;

TEST_CASE("gradients of whole networks are those of difference quotients") {
  const ThreadsGuard one_thread(1);
  for (const std::string_view name : kNetworkNames) {
    for (const bool training : {true, false}) {
      DYNAMIC_SECTION(name << (training ? " train" : " eval")) {
        for (const check::GradientError& leaf : network_gradient_errors(name, training)) {
          INFO(name << " " << leaf.name << ": relative error " << leaf.error << ", gradient norm "
                    << leaf.norm);
          CHECK(leaf.error <= kTolerance);
        }
      }
    }
  }
}

TEST_CASE("the check of a network knows its names") {
  CHECK_THROWS_AS(network_gradient_errors("normals", true), UsageError);
}

}  // namespace
}  // namespace opaline
