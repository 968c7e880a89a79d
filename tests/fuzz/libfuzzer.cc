// One libFuzzer program a parser: OPALINE_FUZZ_TARGET names it. Built with Clang alone (CMakeLists.txt here).
#include <cstddef>
#include <cstdint>
#include <cstdlib>
#include <span>
#include <string_view>

#include "tests/fuzz/targets.h"

extern "C" int LLVMFuzzerTestOneInput(const uint8_t* data, size_t size) {
  for (const opaline::fuzz::Target& target : opaline::fuzz::targets()) {
    if (target.name != std::string_view(OPALINE_FUZZ_TARGET)) continue;
    opaline::fuzz::run(target, std::as_bytes(std::span(data, size)));
    return 0;
  }
  std::abort();
}
