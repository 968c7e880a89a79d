#include "nn/attention.h"

#include <cmath>

#include "core/ops/activation.h"
#include "core/ops/arithmetic.h"
#include "core/ops/shape.h"

namespace opaline {

SelfAttention::SelfAttention(const AttentionConfig& config) : config_(config) {
  if (config_.heads <= 0 || config_.channels % config_.heads != 0) {
    fail("SelfAttention", "{} channels do not divide into {} heads", config_.channels, config_.heads);
  }
}

Tensor SelfAttention::forward(const Tensor& x) const {
  const int64_t batch = x.size(0);
  const int64_t tokens = x.size(1);
  const int64_t depth = config_.channels / config_.heads;
  // N x tokens x channels -> N x heads x tokens x depth
  const auto split = [&](const Tensor& t) {
    return permute(reshape(t, {batch, tokens, config_.heads, depth}), {0, 2, 1, 3});
  };
  // The queries are scaled instead of the scores: they are the smaller tensor.
  const Tensor query = split(affine(query_.forward(x), 1.0 / std::sqrt(static_cast<double>(depth))));
  const Tensor scores = matmul(query, split(key_.forward(x)), {.transpose_b = true});
  const Tensor mixed = matmul(softmax(scores), split(value_.forward(x)));
  return out_.forward(reshape(permute(mixed, {0, 2, 1, 3}), {batch, tokens, config_.channels}));
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
