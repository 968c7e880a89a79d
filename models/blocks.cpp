#include "models/blocks.h"

#include "core/ops/pool.h"
#include "core/ops/shape.h"
#include "core/ops/sites.h"
#include "nn/linear.h"
#include "nn/norm.h"

namespace opaline {
namespace {

// The stem's steps after its convolution begin here.
constexpr size_t kStemRest = 2;

void add_norm_relu(Sequential& sequence, int64_t channels, DType dtype) {
  sequence.add<BatchNorm>(
      BatchNormConfig{.channels = channels, .scale = kBatchNorm2dScale, .relu = true, .dtype = dtype});
  sequence.skip();  // the rectifier
}

}  // namespace

Stem::Stem(Sequential& sequence, int64_t in, int64_t out, DType dtype) : sequence_(&sequence) {
  sequence.skip();  // the padding
  conv_ = &sequence.add<Conv2d>(Conv2dConfig{.in = in,
                                             .out = out,
                                             .kernel = 7,
                                             .padding = 3,
                                             .padding_mode = Padding::kReflect,
                                             .bias = false,
                                             .dtype = dtype});
  add_norm_relu(sequence, out, dtype);
}

Tensor Stem::forward(std::span<const Tensor> parts) const {
  return sequence_->forward(conv_->forward(parts), kStemRest);
}

void add_halving_conv(Sequential& sequence, int64_t in, int64_t out, DType dtype) {
  sequence.add<Conv2d>(Conv2dConfig{
      .in = in, .out = out, .kernel = 3, .stride = 2, .padding = 1, .bias = false, .dtype = dtype});
  add_norm_relu(sequence, out, dtype);
}

void add_vector_head(Sequential& sequence, const VectorHeadConfig& config) {
  const int64_t features = config.in * config.grid * config.grid;
  sequence.add_function([grid = config.grid, features](const Tensor& sites) {
    const Tensor x = to_dense(sites);
    const bool fits = x.size(1) == grid && x.size(2) == grid;
    return reshape(to_nchw(fits ? x : adaptive_avg_pool2d(x, grid, grid)), {x.size(0), features});
  });
  sequence.add<Linear>(LinearConfig{.in = features, .out = config.out, .dtype = config.dtype});
  sequence.add<BatchNorm>(BatchNormConfig{.channels = config.out, .dtype = config.dtype});
}

}  // namespace opaline
