#include "nn/residual.h"

#include "core/ops/arithmetic.h"
#include "nn/conv.h"
#include "nn/norm.h"

namespace opaline {

ResidualBlock::ResidualBlock(const ResidualBlockConfig& config) {
  const Conv2dConfig conv{.in = config.channels,
                          .out = config.channels,
                          .kernel = 3,
                          .padding = 1,
                          .padding_mode = Padding::kReflect,
                          .bias = false,
                          .dtype = config.dtype};
  const BatchNormConfig norm{.channels = config.channels, .scale = kBatchNorm2dScale, .dtype = config.dtype};
  conv_block_.skip();  // the padding
  conv_block_.add<Conv2d>(conv);
  BatchNormConfig rectified = norm;
  rectified.relu = true;
  conv_block_.add<BatchNorm>(rectified);
  conv_block_.skip();  // the rectifier
  conv_block_.skip();
  conv_block_.add<Conv2d>(conv);
  conv_block_.add<BatchNorm>(norm);
}

Tensor ResidualBlock::forward(const Tensor& x) const {
  return add(x, conv_block_.forward(x));
}

}  // namespace opaline
