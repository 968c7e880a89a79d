// Attention (Vaswani et al., NeurIPS 2017).
#pragma once

#include "core/tensor.h"

namespace opaline {

struct AttentionOptions {
  int64_t heads = 1;  ///< parts of the channels that attend on their own
};

/// For each head softmax(query key^T / sqrt(channels / heads)) value. query: N x L x channels, key and value:
/// N x S x channels, channels a multiple of the heads; head h takes the channels [h, h + 1) * channels /
/// heads. Result: N x L x channels. Of active sites (sites x channels each) the sites of an image attend to
/// each other. The L x S scores exist for one head and a block of queries at a time; the backward pass
/// computes them again.
Tensor scaled_dot_product_attention(const Tensor& query, const Tensor& key, const Tensor& value,
                                    const AttentionOptions& options = {});

}  // namespace opaline
