// Parts of the report page. Internal to the report.
#pragma once

#include <nlohmann/json.hpp>
#include <string>
#include <vector>

#include "train/evaluate.h"
#include "train/trained_model.h"

namespace opaline::report {

/// Curves of losses, test errors, learning rate, gradient norm and speed.
std::string curves(const std::vector<nlohmann::json>& events,
                   const std::optional<EvaluationSummary>& summary);
/// Cards and table of errors beside the training mean.
std::string results(const EvaluationSummary& summary);
/// Truth against estimate of the scattering parameters; empty without an SSS estimate.
std::string scatter(const std::vector<SceneResult>& results);
/// Input, truth, prediction and error of `count` scenes from the best to the worst.
std::string gallery(const TrainedModel& model, const Dataset& dataset,
                    const std::vector<SceneResult>& results, int64_t count);
/// Time, speed and host by stage.
std::string timing(const std::vector<nlohmann::json>& events);

}  // namespace opaline::report
