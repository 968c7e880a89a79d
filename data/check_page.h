// The findings of a data set's check as one self-contained HTML page.
#pragma once

#include <string>

#include "data/check.h"

namespace opaline {

/// Verdicts, problems, images of a few scenes, numbers and histograms by split, and a table of the scenes
/// where they are few.
std::string check_page(const DatasetCheck& check, const Dataset& dataset);

}  // namespace opaline
