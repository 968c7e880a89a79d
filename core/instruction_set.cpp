#include "core/instruction_set.h"

#include <hwy/targets.h>

#include <cstdlib>

#include "core/error.h"

namespace opaline {

std::vector<std::string> instruction_sets() {
  std::vector<std::string> names;
  for (const int64_t target : hwy::SupportedAndGeneratedTargets())
    names.emplace_back(hwy::TargetName(target));
  return names;
}

void limit_instruction_set() {
  const char* const wanted = std::getenv("OPALINE_INSTRUCTION_SET");
  if (wanted == nullptr) return;
  for (const int64_t target : hwy::SupportedAndGeneratedTargets()) {
    if (hwy::TargetName(target) != std::string(wanted)) continue;
    hwy::DisableTargets(target - 1);  // better ones are lower bits
    return;
  }
  fail_usage("OPALINE_INSTRUCTION_SET", "{} is none of {}, which this machine has", wanted,
             fmt::join(instruction_sets(), ", "));
}

}  // namespace opaline
