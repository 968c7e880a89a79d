// The vector instructions that kernels use: the best that the machine has, unless told otherwise.
#pragma once

#include <string>
#include <vector>

namespace opaline {

/// Those that the machine has and kernels are compiled for, as Highway names them, the best first.
std::vector<std::string> instruction_sets();

/// Kernels take none better than the environment variable OPALINE_INSTRUCTION_SET names, to compare and to
/// test the others. Call it before anything is computed. Throws UsageError where there is none of that name.
void limit_instruction_set();

}  // namespace opaline
