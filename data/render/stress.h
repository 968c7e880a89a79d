// Media and shapes at the edge of what a scene can hold, in uniform light: no sample may be other than a
// number, no path may be lost, and where nothing is absorbed S0 is 1.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <vector>

#include "data/render/mesh.h"
#include "data/render/path.h"
#include "data/render/validate.h"

namespace opaline::render {

struct StressCase {
  std::string name;
  Mesh mesh;
  Medium medium;
  double index = kRefractiveIndex;
  /// Share of the paths asked for, where the media are so thick that paths are long and their spread small.
  double effort = 1.0;
  /// Angle of incidence of every camera ray, degrees; negative: rays from all around, as they come.
  double incidence = -1.0;
  bool guided = false;
  /// Events lost that pass: other than 0 where rays go where edges are thinner than the numbers' spacing.
  double lost_per_million = 0.0;
};

/// Albedo 0.99, 0.999, 1; g 0, 1e-4, 0.99 and negative; sigma_t 0, 1e-4, 1e4 and 100:1 between colours;
/// grazing and normal incidence; total internal reflection; thin, concave and touching bodies; index 1.
std::vector<StressCase> stress_cases();

/// The same scene, `factor` times as large, with the same optical thickness.
StressCase scaled(const StressCase& stress, double factor);

struct StressOptions {
  int64_t paths = 100'000;
  uint64_t seed = 1;
};

struct StressResult {
  std::array<Estimate, 3> s0;        ///< of the full image, colour by colour
  Estimate clear;                    ///< S0 without the medium
  std::array<bool, 3> conservative;  ///< nothing is absorbed: S0 must be 1
  int64_t not_finite = 0;            ///< samples with an infinity or a NaN, or polarised more than whole
  PathFaults faults;

  double lost_per_million() const;
  /// All samples are numbers; at most `lost_per_million` paths are lost; S0 is 1 within four standard errors
  /// where nothing is absorbed, else between 0 and 1.
  bool passes(double lost_per_million = 0.0) const;
};

StressResult run_stress(const StressCase& stress, const StressOptions& options);

}  // namespace opaline::render
