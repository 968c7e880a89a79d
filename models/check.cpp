#include "models/check.h"

#include "core/autograd.h"
#include "core/ops/sites.h"
#include "nn/pattern.h"

namespace opaline {

NetworkOptions small_network_options(std::string_view name) {
  return {.image_size = 32, .width = name == "illumination_decoder" ? 16 : 4, .dtype = DType::kFloat64};
}

Shape network_input_shape(std::string_view name, int64_t batch, const NetworkOptions& options) {
  if (name == "illumination_decoder") return {batch, illumination_values(options.variant)};
  int64_t channels = options.input_channels;
  if (name == "sss") channels += 5;
  if (name == "reconstruction") channels = kBsdfChannels + sss_values(options.variant);
  return {batch, options.image_size, options.image_size, channels};
}

std::vector<check::GradientError> network_gradient_errors(std::string_view name, bool training,
                                                          const check::GradientOptions& options,
                                                          const std::shared_ptr<const ActiveSites>& sites) {
  const NetworkOptions sizes = small_network_options(name);
  const auto network = make_network(name, sizes);
  test::set_pattern_state(*network);
  network->set_training(training);
  // A BatchNorm over vectors needs a few of them.
  const int64_t batch = sites ? sites->n() : name == "illumination" || name == "sss" ? 4 : 2;
  std::vector<check::Leaf> leaves;
  for (const NamedTensor& parameter : network->named_parameters()) {
    leaves.push_back({parameter.name, parameter.tensor});
  }
  Tensor x = test::pattern_tensor(network_input_shape(name, batch, sizes), test::kInputTag);
  x.set_requires_grad(true);
  leaves.push_back({"x", x});

  const auto forward = [&] { return network->forward(sites ? select_sites(x, sites) : x); };
  const Tensor y = forward();
  const Tensor cotangent = test::pattern_tensor(y.shape(), test::kCotangentTag);
  backward(y, cotangent);
  const auto loss = [&] {
    const NoGradGuard no_grad;
    const Tensor now = forward();
    double sum = 0.0;
    for (int64_t i = 0; i < now.numel(); ++i) sum += (now.at(i) - y.at(i)) * cotangent.at(i);
    return sum;
  };
  return check::check_gradients(loss, leaves, options);
}

}  // namespace opaline
