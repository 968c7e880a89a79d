// --numerics strict|balanced|fast, as several commands have it.
#pragma once

#include <CLI/CLI.hpp>

#include "core/numerics.h"

namespace opaline::cli {

void add_numerics_option(CLI::App& command, Numerics& numerics);

}  // namespace opaline::cli
