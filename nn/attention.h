// Self-attention and the pre-norm transformer block (Vaswani et al., NeurIPS 2017; Dosovitskiy et al., ICLR
// 2021).
#pragma once

#include "nn/linear.h"
#include "nn/module.h"
#include "nn/norm.h"

namespace opaline {

struct AttentionConfig {
  int64_t channels = 0;  ///< of a token; a multiple of heads
  int64_t heads = 8;
  DType dtype = DType::kFloat32;
};

/// Each head: softmax(q k^T / sqrt(channels / heads)) v, with q, k, v linear in the tokens; then `out`.
/// x: N x tokens x channels, and so is the result.
class SelfAttention : public Module {
 public:
  explicit SelfAttention(const AttentionConfig& config);
  Tensor forward(const Tensor& x) const;

 private:
  AttentionConfig config_;
  LinearConfig square_{.in = config_.channels, .out = config_.channels, .dtype = config_.dtype};
  Linear& query_ = add_child<Linear>("query", square_);
  Linear& key_ = add_child<Linear>("key", square_);
  Linear& value_ = add_child<Linear>("value", square_);
  Linear& out_ = add_child<Linear>("out", square_);
};

struct TransformerBlockConfig {
  int64_t channels = 0;
  int64_t heads = 8;
  int64_t mlp_channels = 0;
  double norm_eps = 1e-6;
  DType dtype = DType::kFloat32;
};

/// x + attention(norm(x)), then x + mlp(norm(x)) with an exact GELU. x: N x tokens x channels.
class TransformerBlock : public Module {
 public:
  explicit TransformerBlock(const TransformerBlockConfig& config);
  Tensor forward(const Tensor& x) const;

 private:
  TransformerBlockConfig config_;
  LayerNormConfig norm_{.channels = config_.channels, .eps = config_.norm_eps, .dtype = config_.dtype};
  LayerNorm& attention_norm_ = add_child<LayerNorm>("attention_norm", norm_);
  LayerNorm& ffn_norm_ = add_child<LayerNorm>("ffn_norm", norm_);
  FcStack& ffn_;
  SelfAttention& attn_;
};

}  // namespace opaline
