// Module: the base of layers, blocks and networks. It keeps the parameters, buffers and children under the
// names and in the order of PyTorch's state_dict, so that weights travel both ways. A module registers what
// it has in its member initialisers, which makes declaration order the order of the state dict:
//
//   class Head : public Module {
//    public:
//     Tensor forward(const Tensor& x) { return norm_.forward(fc_.forward(x)); }
//
//    private:
//     Linear& fc_ = add_child<Linear>("fc", LinearConfig{.in = 64, .out = 8});
//     BatchNorm& norm_ = add_child<BatchNorm>("norm", BatchNormConfig{.channels = 8});
//   };
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <vector>

#include "core/safetensors.h"
#include "core/tensor.h"

namespace opaline {

/// How a parameter starts: drawn from normal(mean, deviation); a deviation of 0 is the constant `mean`.
struct InitialValue {
  double mean = 0.0;
  double deviation = 0.0;
};

/// A parameter or buffer with its full name ("inc.double_conv.0.weight").
struct NamedTensor {
  std::string name;
  Tensor tensor;
  InitialValue initial = {};
};

struct LoadStateOptions {
  bool allow_non_finite = false;  ///< take NaN and infinities
  std::string source = "state";   ///< what errors call the tensors: a file, say
};

class Module {
 public:
  Module() = default;
  virtual ~Module() = default;
  Module(const Module&) = delete;
  Module& operator=(const Module&) = delete;

  /// Own ones first, then the children's, depth first.
  std::vector<NamedTensor> named_parameters() const;
  std::vector<NamedTensor> named_buffers() const;
  /// Parameters and buffers in the order of PyTorch's state_dict.
  std::vector<NamedTensor> named_state() const;
  int64_t parameter_count() const;

  /// The live tensors, not copies: clone before training goes on.
  TensorMap state_dict() const;
  /// Overwrites parameters and buffers in place; floating types are converted. Names and shapes must be the
  /// module's own: otherwise Error lists everything missing, extra or mis-shaped, and nothing is changed. So
  /// do NaN and infinities unless allowed.
  void load_state_dict(const TensorMap& state, const LoadStateOptions& options = {});

  /// Training or evaluation mode, children included. Modules start in training mode.
  void set_training(bool on);
  bool training() const { return training_; }
  /// Whether the parameters collect gradients (they do at the start); a frozen network has none.
  void set_requires_grad(bool on);
  void zero_grad();

 protected:
  /// Registers a parameter and returns a handle to it. It holds `initial.mean` until initialize() draws it.
  Tensor add_parameter(std::string name, Shape shape, DType dtype, InitialValue initial);
  /// Registers a buffer: state that is saved, but not trained.
  Tensor add_buffer(std::string name, Tensor value);
  /// Makes a child; the reference lives as long as this module.
  template <class M, class... Args>
  M& add_child(std::string name, Args&&... args) {
    auto child = std::make_unique<M>(std::forward<Args>(args)...);
    M& reference = *child;
    children_.push_back({std::move(name), std::move(child)});
    return reference;
  }

 private:
  struct Child {
    std::string name;
    std::unique_ptr<Module> module;
  };
  enum class Kind { kParameters, kBuffers, kBoth };
  void collect(const std::string& prefix, Kind kind, std::vector<NamedTensor>& out) const;

  std::vector<NamedTensor> parameters_;
  std::vector<NamedTensor> buffers_;
  std::vector<Child> children_;
  bool training_ = true;
};

/// Draws every parameter from its InitialValue. Parameter i of the module takes the stream
/// Random(seed, Purpose::kInit, 0, first_index + i), so weights depend on nothing but the seed and their
/// place, and float32 weights are the rounded float64 ones.
void initialize(Module& module, uint64_t seed, uint32_t first_index = 0);

}  // namespace opaline
