// What the machine can do at most: the yardsticks that benchmarks are held against.
#pragma once

namespace opaline::bench {

struct MachineLimits {
  double gflops = 0;                ///< float32 fused multiply-adds (two operations each), all threads
  double gigabytes_per_second = 0;  ///< of streaming reads from memory, all threads
  const char* instruction_set = "";
};

/// Measures both with the threads in force (about half a second).
MachineLimits measure_machine();

}  // namespace opaline::bench
