#include "nn/optim.h"

#include <algorithm>
#include <cmath>

#include "core/parallel.h"
#include "nn/state.h"

namespace opaline {
namespace {

// Elements in one unit of parallel work.
constexpr int64_t kBlock = int64_t{1} << 16;

struct AdamCoefficients {
  double beta1, beta2;
  double step_size;         // rate / (1 - beta1^t)
  double root_correction2;  // sqrt(1 - beta2^t)
  double eps;
};

/// Elements [begin, end) of one parameter; the moments are updated in place.
template <class T>
void adam_update(Tensor& parameter, const Tensor& grad, Tensor& moment1, Tensor& moment2,
                 const AdamCoefficients& c, int64_t begin, int64_t end) {
  T* p = parameter.data<T>();
  const T* g = grad.data<T>();
  T* m = moment1.data<T>();
  T* v = moment2.data<T>();
  const T beta1 = static_cast<T>(c.beta1);
  const T beta2 = static_cast<T>(c.beta2);
  const T rest1 = static_cast<T>(1.0 - c.beta1);
  const T rest2 = static_cast<T>(1.0 - c.beta2);
  const T step_size = static_cast<T>(c.step_size);
  const T root = static_cast<T>(c.root_correction2);
  const T eps = static_cast<T>(c.eps);
  for (int64_t i = begin; i < end; ++i) {
    m[i] = beta1 * m[i] + rest1 * g[i];
    v[i] = beta2 * v[i] + rest2 * g[i] * g[i];
    p[i] -= step_size * m[i] / (std::sqrt(v[i]) / root + eps);
  }
}

}  // namespace

Adam::Adam(std::vector<NamedTensor> parameters, const AdamOptions& options)
    : options_(options), parameters_(std::move(parameters)) {
  for (const auto& [name, tensor, initial] : parameters_) {
    moments1_.push_back({"exp_avg." + name, Tensor::zeros(tensor.shape(), tensor.dtype())});
    moments2_.push_back({"exp_avg_sq." + name, Tensor::zeros(tensor.shape(), tensor.dtype())});
    steps_.push_back({"step." + name, Tensor::zeros({}, DType::kInt64)});
  }
  to_map(steps_);  // throws on equal names
}

void Adam::step(double rate_factor) {
  const double rate = options_.learning_rate * rate_factor;
  struct Update {
    size_t parameter;
    Tensor grad;
    AdamCoefficients coefficients;
  };
  struct Block {
    size_t update;
    int64_t begin;
  };
  std::vector<Update> updates;
  std::vector<Block> blocks;
  for (size_t i = 0; i < parameters_.size(); ++i) {
    const Tensor grad = parameters_[i].tensor.grad();
    if (!grad.defined()) continue;
    const auto t = static_cast<double>(++*steps_[i].tensor.data<int64_t>());
    for (int64_t begin = 0; begin < grad.numel(); begin += kBlock) blocks.push_back({updates.size(), begin});
    updates.push_back({i, grad,
                       AdamCoefficients{.beta1 = options_.beta1,
                                        .beta2 = options_.beta2,
                                        .step_size = rate / (1.0 - std::pow(options_.beta1, t)),
                                        .root_correction2 = std::sqrt(1.0 - std::pow(options_.beta2, t)),
                                        .eps = options_.eps}});
  }
  // All parameters in one parallel loop: most are too small to share among threads.
  parallel_for(static_cast<int64_t>(blocks.size()), [&](int64_t unit) {
    const Block& block = blocks[static_cast<size_t>(unit)];
    const Update& update = updates[block.update];
    Tensor& parameter = parameters_[update.parameter].tensor;
    dispatch_floating("adam", parameter.dtype(), [&]<class T>() {
      adam_update<T>(parameter, update.grad, moments1_[update.parameter].tensor,
                     moments2_[update.parameter].tensor, update.coefficients, block.begin,
                     std::min(block.begin + kBlock, parameter.numel()));
    });
  });
  ++*step_count_.tensor.data<int64_t>();
}

void Adam::zero_grad() {
  for (NamedTensor& parameter : parameters_) parameter.tensor.zero_grad();
}

std::vector<NamedTensor> Adam::named_state() const {
  std::vector<NamedTensor> state = moments1_;
  state.insert(state.end(), moments2_.begin(), moments2_.end());
  state.insert(state.end(), steps_.begin(), steps_.end());
  state.push_back(step_count_);
  return state;
}

TensorMap Adam::state_dict() const {
  return to_map(named_state());
}

void Adam::load_state_dict(const TensorMap& state, const std::string& source) {
  load_state(named_state(), state, {.source = source});
}

double gradient_norm(const std::vector<NamedTensor>& parameters) {
  double total = 0.0;
  for (const NamedTensor& parameter : parameters) {
    const Tensor grad = parameter.tensor.grad();
    if (!grad.defined()) continue;
    dispatch_floating("gradient_norm", grad.dtype(), [&]<class T>() {
      const std::span<const T> values = std::as_const(grad).values<T>();
      std::vector<double> partial(static_cast<size_t>((grad.numel() + kBlock - 1) / kBlock));
      parallel_blocks(grad.numel(), kBlock, [&](int64_t begin, int64_t end) {
        double sum = 0.0;
        for (int64_t i = begin; i < end; ++i) {
          const auto value = static_cast<double>(values[static_cast<size_t>(i)]);
          sum += value * value;
        }
        partial[static_cast<size_t>(begin / kBlock)] = sum;
      });
      for (const double sum : partial) total += sum;
    });
  }
  return std::sqrt(total);
}

}  // namespace opaline
