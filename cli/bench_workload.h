// What benchmarks run: networks and stages with fresh weights on noise, and how errors are summed.
#pragma once

#include <cstdint>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "core/tensor.h"
#include "nn/module.h"

namespace opaline::cli {

/// Float32 noise, the same in every run: uniform in [low, high), or normal around 0. Each `sample` has a
/// stream of its own.
Tensor random_uniform(Shape shape, uint32_t sample, double low = -1.0, double high = 1.0);
Tensor random_normal(Shape shape, uint32_t sample, double deviation = 1.0);

/// Root mean square of the differences over that of the reference, of all tensors added so far together.
class RelativeError {
 public:
  /// Shapes must agree; types may be any.
  void add(const Tensor& value, const Tensor& reference);
  /// Not relative where the reference is all zeros.
  double value() const;

 private:
  double difference_ = 0.0, size_ = 0.0;
};

/// Shape of what a network of the released variant reads: N x H x W x C; N x K for the decoder.
Shape input_shape(std::string_view net, int64_t batch, int64_t size);

struct Workload {
  std::string net;        ///< one of workload_names()
  int64_t size = 256;     ///< of the images, and the build size
  int64_t batch = 1;      ///< images
  int64_t width = 64;     ///< channels of the first layer
  std::string mask = {};  ///< the object: a PNG file or a share of the pixels; empty: all of them
  bool skip = false;      ///< compute on the tiles that touch the mask alone
  int64_t illumination_downscale = 1;  ///< of a stage: of the images that the illumination network sees
  bool checkpoint = false;             ///< of a stage: activation checkpointing
};

/// The networks; "stage1" and "stage2", the networks of a stage with its losses; "cascade", what prediction
/// computes: all networks but the reconstruction.
std::vector<std::string> workload_names();

/// What is timed: a forward pass that gives a scalar or a result, and how to go backward from it.
class Step {
 public:
  virtual ~Step() = default;
  virtual Tensor forward() = 0;
  virtual void go_backward(const Tensor& result) = 0;
  virtual void zero_grad() = 0;
  virtual void set_training(bool on) = 0;
  virtual std::vector<NamedTensor> parameters() const = 0;
  /// The share of the pixels that are computed where something is skipped.
  virtual double computed_share() const = 0;
};

/// Throws UsageError on sizes that the networks cannot have and on a bad mask.
std::unique_ptr<Step> make_step(const Workload& workload);

}  // namespace opaline::cli
