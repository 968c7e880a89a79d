// The ResNet block (He et al., CVPR 2016), in the form of image-to-image generators: reflection padding and
// no activation after the sum (Johnson et al., ECCV 2016).
#pragma once

#include "nn/module.h"
#include "nn/sequential.h"

namespace opaline {

struct ResidualBlockConfig {
  int64_t channels = 0;
  DType dtype = DType::kFloat32;
};

/// x + norm(conv(relu(norm(conv(x))))): 3x3 convolutions without bias, reflection padding, BatchNorm.
/// x: N x H x W x channels.
class ResidualBlock : public Module {
 public:
  explicit ResidualBlock(const ResidualBlockConfig& config);
  Tensor forward(const Tensor& x) const;

 private:
  Sequential& conv_block_ = add_child<Sequential>("conv_block");
};

}  // namespace opaline
