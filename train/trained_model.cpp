#include "train/trained_model.h"

#include <algorithm>

#include "core/error.h"

namespace opaline {

TrainedModel load_trained_model(const RunFolder& run, const Warn& warn, std::vector<std::string> networks) {
  if (!std::filesystem::exists(run.config())) {
    fail_usage(run.root.string(), "is not a run folder: it has no config.toml");
  }
  TrainedModel model;
  model.config = load_run_config(run.config());
  if (networks.empty()) {
    for (const std::string_view name : kNetworkNames) {
      if (name != "reconstruction") networks.emplace_back(name);
    }
  }
  const Checkpoint checkpoint =
      load_newest_checkpoint(run.checkpoints(), warn, {.networks = networks, .optimizer = false});
  model.state = checkpoint.state;
  model.checkpoint = checkpoint.folder;
  CascadeOptions options = cascade_options(model.config, checkpoint.state.stage);
  options.reconstruction = std::find(networks.begin(), networks.end(), "reconstruction") != networks.end();
  model.cascade = std::make_unique<Cascade>(options);
  for (const std::string& name : networks) {
    if (model.cascade->has(name) && !checkpoint.networks.contains(name)) {
      fail(checkpoint.folder.string(), "has no {}.safetensors", name);
    }
  }
  restore_networks(checkpoint, *model.cascade);
  model.cascade->set_training(false);
  return model;
}

}  // namespace opaline
