#include "nn/attention.h"

#include "core/ops/activation.h"
#include "core/ops/arithmetic.h"
#include "core/ops/attention.h"

namespace opaline {

SelfAttention::SelfAttention(const AttentionConfig& config) : config_(config) {
  if (config_.heads <= 0 || config_.channels % config_.heads != 0) {
    fail("SelfAttention", "{} channels do not divide into {} heads", config_.channels, config_.heads);
  }
}

Tensor SelfAttention::forward(const Tensor& x) const {
  const Tensor mixed = scaled_dot_product_attention(query_.forward(x), key_.forward(x), value_.forward(x),
                                                    {.heads = config_.heads});
  return out_.forward(mixed);
}

TransformerBlock::TransformerBlock(const TransformerBlockConfig& config)
    : config_(config),
      ffn_(add_child<FcStack>("ffn",
                              FcStackConfig{.widths = {config.channels, config.mlp_channels, config.channels},
                                            .activation = gelu,
                                            .dtype = config.dtype})),
      attn_(add_child<SelfAttention>(
          "attn",
          AttentionConfig{.channels = config.channels, .heads = config.heads, .dtype = config.dtype})) {}

Tensor TransformerBlock::forward(const Tensor& x) const {
  const Tensor attended = add(x, attn_.forward(attention_norm_.forward(x)));
  return add(attended, ffn_.forward(ffn_norm_.forward(attended)));
}

}  // namespace opaline
