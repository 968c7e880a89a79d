// What `opaline train` and `opaline resume` share.
#pragma once

#include "cli/commands.h"
#include "train/config.h"
#include "train/trainer.h"

namespace opaline::cli {

/// Says how training ended, and sets the exit code where a signal ended it.
void report_training(const TrainResult& result, const RunFolder& run, Outcome& outcome);

void print_warnings(const RunConfig& config);

}  // namespace opaline::cli
