#include "train/run_folder.h"

namespace opaline {

RunLock::RunLock(const RunFolder& run)
    : lock_(run.lock(), "is training in this run folder; stop it or choose another --run") {}

}  // namespace opaline
