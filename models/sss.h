// The ResNet that estimates subsurface scattering.
#pragma once

#include "models/blocks.h"
#include "models/network.h"
#include "nn/sequential.h"

namespace opaline {

struct SssConfig {
  int64_t in = 0;
  int64_t out = 8;
  int64_t image_size = 256;  ///< the Linear layer sees image_size / 16 squared positions
  int64_t width = 64;
  DType dtype = DType::kFloat32;
};

/// N x H x W x in -> N x out in (-1, 1): g, sigma_t (3), albedo (3) and, in the release, flash radiance
/// (ranges: models/network.h). In training mode N must be at least 2.
class SssNetwork : public Network {
 public:
  explicit SssNetwork(const SssConfig& config);

 private:
  Tensor run(std::span<const Tensor> parts) override;

  /// The two halves bear their names in the state dict, each around one `model`.
  class Half : public Module {
   public:
    Sequential& model = add_child<Sequential>("model");
  };

  SssConfig config_;
  Half& feature_encoder_ = add_child<Half>("feature_encoder");
  Half& scatter_encoder_ = add_child<Half>("scatter_encoder");
  Stem stem_;
};

}  // namespace opaline
