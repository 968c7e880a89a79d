#include "models/cascade.h"

#include "core/autograd.h"
#include "core/ops/pool.h"
#include "core/ops/resize.h"
#include "core/ops/shape.h"
#include "core/ops/sites.h"

namespace opaline {
namespace {

bool belongs(std::string_view name, const CascadeOptions& options) {
  if (name == "normal" || name == "depth" || name == "illumination") return true;
  if (name == "reconstruction" && !options.reconstruction) return false;
  return options.stage == 2;
}

// N x K values over all pixels, N x height x width x K, or over those of the sites.
Tensor broadcast_over_image(const Tensor& values, int64_t height, int64_t width,
                            const std::shared_ptr<const ActiveSites>& sites) {
  if (sites) return expand_to_sites(values, sites);
  const int64_t batch = values.size(0);
  const int64_t count = values.size(1);
  return expand(reshape(values, {batch, 1, 1, count}), {batch, height, width, count});
}

}  // namespace

std::string_view to_string(Skip skip) {
  return skip == Skip::kNone ? "none" : "support";
}

std::optional<Skip> parse_skip(std::string_view text) {
  for (const Skip skip : {Skip::kNone, Skip::kSupport}) {
    if (text == to_string(skip)) return skip;
  }
  return std::nullopt;
}

CascadeOutput whole(const CascadeOutput& output) {
  CascadeOutput result = output;
  for (Tensor* image : {&result.normal, &result.depth, &result.illumination_map, &result.reconstruction}) {
    if (image->defined()) *image = to_dense(*image);
  }
  return result;
}

Cascade::Cascade(const CascadeOptions& options) : options_(options) {
  if (options_.stage != 1 && options_.stage != 2) {
    fail_usage("cascade", "stage {} is neither 1 nor 2", options_.stage);
  }
  if (options_.illumination_downscale < 1) {
    fail_usage("cascade", "illumination_downscale {} must be at least 1", options_.illumination_downscale);
  }
  for (const std::string_view name : kNetworkNames) {
    if (belongs(name, options_)) networks_.emplace(name, make_network(name, options_.network));
  }
}

CascadeOutput Cascade::forward(const CascadeInput& input) {
  const bool stage2 = options_.stage == 2;
  return forward(input, {.sss = stage2, .reconstruction = stage2 && options_.reconstruction});
}

CascadeOutput Cascade::forward(const CascadeInput& input, const CascadeWanted& wanted) {
  const bool sss = wanted.sss || wanted.reconstruction;
  const int64_t height = input.image.size(1);
  const int64_t width = input.image.size(2);
  std::shared_ptr<const ActiveSites> sites;
  if (const std::optional<int64_t> dilation = options_.support()) {
    if (!input.mask.defined()) fail("cascade", "skipping what lies outside the mask needs a mask");
    sites = input.mask.sites() ? input.mask.sites() : support_of(input.mask, *dilation);
  }
  const auto selected = [&sites](const Tensor& x) { return sites ? select_sites(x, sites) : x; };
  const Tensor image = wanted.normal || wanted.depth || sss ? selected(input.image) : Tensor();
  const auto run = [&](std::string_view name, std::vector<Tensor> inputs) {
    const auto forward = [&net = network(name)](std::span<const Tensor> parts) { return net.forward(parts); };
    return options_.checkpoint ? checkpoint(name, forward, inputs) : forward(inputs);
  };
  CascadeOutput out;
  if (wanted.normal || sss) out.normal = run("normal", {image});
  if (wanted.depth || sss) out.depth = run("depth", {image});
  if (wanted.illumination || sss) {
    const int64_t side = options_.illumination_downscale;
    out.illumination =
        run("illumination",
            {side == 1 ? input.image : adaptive_avg_pool2d(input.image, height / side, width / side)});
  }
  if (!sss) return out;

  const Tensor map = run("illumination_decoder", {out.illumination});
  const bool fits = map.size(1) == height && map.size(2) == width;
  out.illumination_map = selected(fits ? map : upsample_bilinear(map, {.height = height, .width = width}));
  out.sss = run("sss", {out.illumination_map, out.normal, out.depth, image});
  if (!wanted.reconstruction) return out;

  if (!input.bsdf.defined()) fail("cascade", "the reconstruction needs the pure-BSDF images");
  out.reconstruction =
      run("reconstruction", {selected(input.bsdf), broadcast_over_image(out.sss, height, width, sites)});
  return out;
}

std::vector<std::string> Cascade::network_names() const {
  std::vector<std::string> names;
  for (const std::string_view name : kNetworkNames) {
    if (has(name)) names.emplace_back(name);
  }
  return names;
}

bool Cascade::has(std::string_view name) const {
  return networks_.contains(name);
}

Network& Cascade::network(std::string_view name) {
  const auto found = networks_.find(name);
  if (found == networks_.end()) {
    fail("cascade", "stage {} has no network '{}'; it has {}", options_.stage, name,
         fmt::join(network_names(), ", "));
  }
  return *found->second;
}

const Network& Cascade::network(std::string_view name) const {
  return const_cast<Cascade*>(this)->network(name);
}

void Cascade::initialize(uint64_t seed) {
  for (const auto& [name, network] : networks_) initialize_network(*network, name, seed);
}

std::vector<NamedTensor> Cascade::named_parameters() const {
  std::vector<NamedTensor> result;
  for (const std::string& name : network_names()) {
    for (NamedTensor& parameter : network(name).named_parameters()) {
      result.push_back({name + "." + parameter.name, parameter.tensor, parameter.initial});
    }
  }
  return result;
}

void Cascade::set_training(bool on) {
  for (const auto& [name, network] : networks_) network->set_training(on);
}

void Cascade::zero_grad() {
  for (const auto& [name, network] : networks_) network->zero_grad();
}

}  // namespace opaline
