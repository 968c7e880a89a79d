// Scenes of `opaline bench render` as files that other renderers can read.
#pragma once

#include <filesystem>

#include "cli/bench_error.h"
#include "cli/bench_scenes.h"

namespace opaline::cli {

/// Writes `folder`/NAME.json (camera, light, medium, index, reference of S0: the first colour, H x W, with
/// the variance of its mean) and body.ply, which it names.
void export_bench_scene(const BenchScene& scene, const render::Camera& camera, const Reference& reference,
                        const std::filesystem::path& folder);

}  // namespace opaline::cli
