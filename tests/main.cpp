#define CATCH_CONFIG_RUNNER
#include <catch2/catch.hpp>
#include <cstdio>

#include "core/error.h"
#include "core/instruction_set.h"

int main(int argc, char** argv) {
  try {
    opaline::limit_instruction_set();
  } catch (const opaline::UsageError& error) {
    std::fprintf(stderr, "skipped: %s\n", error.what());
    return 77;  // as tests/CMakeLists.txt has it
  }
  return Catch::Session().run(argc, argv);
}
