// The illumination encoder (image to SH coefficients and flash) and decoder (back to a map for the SSS
// network).
#pragma once

#include "models/blocks.h"
#include "models/network.h"
#include "nn/linear.h"
#include "nn/norm.h"
#include "nn/sequential.h"

namespace opaline {

struct IlluminationEncoderConfig {
  int64_t in = 0;
  int64_t out = 27;
  int64_t image_size = 256;  ///< the Linear layer sees image_size / 8 squared positions
  int64_t width = 64;
  DType dtype = DType::kFloat32;
};

/// N x H x W x in -> N x out, through a last BatchNorm: in training mode N must be at least 2.
class IlluminationEncoder : public Network {
 public:
  explicit IlluminationEncoder(const IlluminationEncoderConfig& config);

 private:
  Tensor run(std::span<const Tensor> parts) override;

  IlluminationEncoderConfig config_;
  Sequential& model_ = add_child<Sequential>("model");
  Stem stem_;
};

struct IlluminationDecoderConfig {
  int64_t in = 27;
  int64_t image_size = 256;
  int64_t width = 64;
  DType dtype = DType::kFloat32;
};

/// N x in -> N x S x S x 1 in (-1, 1), S the power of two at or over image_size, at most 256: log2 S
/// transposed convolutions, each doubling the size, to 16w, 8w, .. w/4, 1 channels (the last log2 S of these
/// eight).
class IlluminationDecoder : public Network {
 public:
  explicit IlluminationDecoder(const IlluminationDecoderConfig& config);

 private:
  Tensor run(std::span<const Tensor> parts) override;

  IlluminationDecoderConfig config_;
  Sequential& model_ = add_child<Sequential>("model");
};

}  // namespace opaline
