// What the machine can do, measured: the marks that operations are held against.
#pragma once

#include <string>

namespace opaline {

struct Machine {
  double gflops = 0.0;                ///< float32 fused multiply-adds on all threads, two operations each
  double gigabytes_per_second = 0.0;  ///< copy of arrays far larger than the caches, bytes read and written
  std::string instruction_set;        ///< as Highway names it
};

/// Best of a few runs, with the threads that parallel_for uses. Takes about a second.
Machine measure_machine();

}  // namespace opaline
