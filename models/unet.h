// The SfPW U-Net with a transformer bottleneck (Lei et al., CVPR 2022): normal, depth and reconstruction.
#pragma once

#include <string>

#include "models/network.h"
#include "nn/attention.h"
#include "nn/conv.h"
#include "nn/sequential.h"

namespace opaline {

/// What normalises the two convolutions of a block.
enum class BlockNorm { kBatch, kInstance };

struct DoubleConvConfig {
  int64_t in = 0;
  int64_t middle = 0;  ///< channels between the convolutions
  int64_t out = 0;
  BlockNorm norm = BlockNorm::kBatch;
  DType dtype = DType::kFloat32;
};

/// [conv 3x3 with bias, norm, ReLU] twice; N x H x W x in -> N x H x W x out. The input may come as images
/// that are joined along their channels.
class DoubleConv : public Module {
 public:
  explicit DoubleConv(const DoubleConvConfig& config);
  Tensor forward(const Tensor& x) const { return forward(std::span(&x, 1)); }
  Tensor forward(std::span<const Tensor> parts) const {
    return double_conv_.forward(first_->forward(parts), 1);
  }

 private:
  Sequential& double_conv_ = add_child<Sequential>("double_conv");
  const Conv2d* first_;  // step 0 of double_conv_
};

/// Max-pooling by 2, then a DoubleConv: N x H x W x C -> N x H/2 x W/2 x out.
class Down : public Module {
 public:
  explicit Down(const DoubleConvConfig& config);
  Tensor forward(const Tensor& x) const { return maxpool_conv_.forward(x); }

 private:
  Sequential& maxpool_conv_ = add_child<Sequential>("maxpool_conv");
};

/// Bilinear upsampling to the size of the skip connection (align_corners), then a DoubleConv on
/// [skip, upsampled].
class Up : public Module {
 public:
  explicit Up(const DoubleConvConfig& config) : conv_(add_child<DoubleConv>("conv", config)) {}
  Tensor forward(const Tensor& x, const Tensor& skip) const;

 private:
  DoubleConv& conv_;
};

/// The 1x1 convolution at the end.
class OutConv : public Module {
 public:
  explicit OutConv(const Conv2dConfig& config) : conv_(add_child<Conv2d>("conv", config)) {}
  Tensor forward(const Tensor& x) const { return conv_.forward(x); }

 private:
  Conv2d& conv_;
};

struct TransUnetConfig {
  std::string name = "unet";  ///< what errors call it
  int64_t in = 0;
  int64_t out = 0;
  int64_t width = 64;
  DType dtype = DType::kFloat32;
};

/// N x H x W x in -> N x H x W x out, no output activation. With width w: w channels at full size, 8w at
/// 1/16, where 8 transformer blocks of 8 heads treat each pixel as a token (no positional encoding).
class TransUnet : public Network {
 public:
  explicit TransUnet(const TransUnetConfig& config);

 private:
  Tensor run(std::span<const Tensor> parts) override;
  DoubleConvConfig block(int64_t in, int64_t middle, int64_t out, BlockNorm norm) const;

  TransUnetConfig config_;
  DoubleConv& inc_;
  Down &down1_, &down2_, &down3_, &down4_;
  Up &up1_, &up2_, &up3_, &up4_;
  OutConv& outc_;
  Sequential& resblock_layers_;
};

}  // namespace opaline
