// Whatever core/ops declares has a case, and whatever has a case is declared there.
#include <algorithm>
#include <catch2/catch.hpp>
#include <filesystem>
#include <regex>
#include <set>
#include <string>

#include "core/check/op_case.h"
#include "core/file.h"

namespace opaline::check {
namespace {

/// Names of the functions that a header declares at the left margin with a Tensor as their result.
std::set<std::string> declared_operations(const std::string& header) {
  static const std::regex declaration("(^|\n)Tensor ([a-z0-9_]+)\\(");
  std::set<std::string> names;
  for (auto it = std::sregex_iterator(header.begin(), header.end(), declaration);
       it != std::sregex_iterator(); ++it) {
    names.insert((*it)[2]);
  }
  return names;
}

std::set<std::string> public_operations() {
  std::set<std::string> names;
  for (const auto& entry :
       std::filesystem::directory_iterator(std::string(OPALINE_SOURCE_DIR) + "/core/ops")) {
    if (entry.path().extension() != ".h") continue;
    const std::string text = read_text(entry.path());
    if (text.find("Internal to core/ops.") != std::string::npos) continue;
    names.merge(declared_operations(text));
  }
  return names;
}

TEST_CASE("every operation has a case and every case an operation") {
  const std::set<std::string> declared = public_operations();
  REQUIRE(declared.size() > 30);
  REQUIRE(declared.contains("conv2d"));
  std::set<std::string> covered;
  for (const OpCase& op_case : op_cases()) covered.emplace(op_case.operation());
  for (const std::string& name : declared) {
    INFO(name);
    CHECK(covered.contains(name));
  }
  for (const std::string& name : covered) {
    INFO(name);
    CHECK(declared.contains(name));
  }
}

TEST_CASE("every operation has a case that checks its gradient") {
  std::set<std::string> smooth;
  for (const OpCase& op_case : op_cases()) {
    if (op_case.smooth) smooth.emplace(op_case.operation());
  }
  for (const std::string& name : public_operations()) {
    INFO(name);
    CHECK(smooth.contains(name));
  }
}

TEST_CASE("every operation that takes time is in the benchmark") {
  std::set<std::string> timed;
  for (const OpCase& op_case : large_op_cases(16)) timed.emplace(op_case.operation());
  for (const std::string name :
       {"conv2d", "conv_transpose2d", "linear", "matmul", "batch_norm", "instance_norm", "layer_norm",
        "max_pool2d", "upsample_bilinear", "softmax", "gelu", "concat"}) {
    INFO(name);
    CHECK(timed.contains(name));
  }
}

TEST_CASE("names of cases are unique") {
  std::set<std::string> names;
  for (const OpCase& op_case : op_cases()) {
    INFO(op_case.name);
    CHECK(names.insert(op_case.name).second);
    CHECK(!op_case.variant().empty());
  }
}

TEST_CASE("the list of operations sees what a header declares") {
  CHECK(declared_operations("Tensor f(const Tensor& x);\n  Tensor no(int);\n// Tensor g(\nTensor h_2d(\n") ==
        std::set<std::string>{"f", "h_2d"});
}

}  // namespace
}  // namespace opaline::check
