#include "core/ops/attention.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "core/autograd.h"
#include "core/kernels/gemm.h"
#include "core/kernels/scratch.h"
#include "core/kernels/tile.h"
#include "core/kernels/transformer.h"
#include "core/ops/sites.h"
#include "core/parallel.h"

namespace opaline {
namespace {

constexpr int64_t kQueries = 128;  // of a block

struct Sizes {
  int64_t batch, channels, heads;
  std::vector<int64_t> first_query, first_key;  ///< rows of each image, and of all
  int64_t depth() const { return channels / heads; }
  double scale() const { return 1.0 / std::sqrt(static_cast<double>(depth())); }
};

/// One head of one image.
template <class T>
struct Head {
  const Sizes& s;
  int64_t queries, keys;
  int64_t query_at, key_at;  // first elements

  Head(const Sizes& sizes, int64_t unit) : s(sizes) {
    const auto image = static_cast<size_t>(unit / sizes.heads);
    const int64_t channel = unit % sizes.heads * sizes.depth();
    queries = s.first_query[image + 1] - s.first_query[image];
    keys = s.first_key[image + 1] - s.first_key[image];
    query_at = s.first_query[image] * s.channels + channel;
    key_at = s.first_key[image] * s.channels + channel;
  }

  /// keys x depth, as rows or as columns of the factor of a product.
  kernels::PackedMatrix<T> rows(const Tensor& x) const {
    return {keys, s.depth(), {x.data<T>() + key_at, s.channels, 1}};
  }
  kernels::PackedMatrix<T> columns(const Tensor& x) const {
    return {s.depth(), keys, {x.data<T>() + key_at, 1, s.channels}};
  }
};

/// to (keys x depth, `stride` apart) = scores^T (queries x keys) x, x being queries x depth, `stride` apart.
template <class T>
void add_transposed_product(int64_t queries, int64_t keys, int64_t depth, const T* scores,
                            int64_t scores_stride, const T* x, int64_t stride, bool accumulate, T* to) {
  const kernels::Tiles<T>& tile = kernels::tiles<T>();
  const int64_t width = depth <= tile.lanes ? tile.lanes : tile.width();
  const kernels::Scratch<T> panel(queries * width);
  for (int64_t j = 0; j < depth; j += width) {
    const int64_t valid = std::min(width, depth - j);
    for (int64_t i = 0; i < queries; ++i) {
      std::copy_n(x + i * stride + j, valid, panel.data() + i * width);
      std::fill(panel.data() + i * width + valid, panel.data() + (i + 1) * width, T{});
    }
    kernels::OuterTile<T> t;
    t.a_stride = scores_stride;
    t.b = panel.data();
    t.b_stride = width;
    t.pixels = queries;
    t.c_stride = stride;
    t.columns = valid;
    t.accumulate = accumulate;
    for (int64_t k = 0; k < keys; k += tile.rows) {
      t.a = scores + k;
      t.rows = std::min(tile.rows, keys - k);
      t.c = to + k * stride + j;
      tile.outer(t);
    }
  }
}

template <class T>
void attend(const Sizes& s, const Tensor& query, const Tensor& key, const Tensor& value, Tensor& y) {
  const kernels::TransformerKernels<T>& k = kernels::transformer_kernels<T>();
  parallel_for(s.batch * s.heads, [&](int64_t unit) {
    const Head<T> head(s, unit);
    if (head.queries == 0) return;
    const kernels::PackedMatrix<T> keys = head.columns(key), values = head.rows(value);
    const kernels::Scratch<T> scores(kQueries * head.keys);
    for (int64_t begin = 0; begin < head.queries; begin += kQueries) {
      const int64_t count = std::min(kQueries, head.queries - begin), at = head.query_at + begin * s.channels;
      keys.multiply(count, query.data<T>() + at, s.channels, scores.data(), head.keys);
      for (int64_t i = 0; i < count; ++i) {
        T* const row = scores.data() + i * head.keys;
        k.softmax(row, head.keys, static_cast<T>(s.scale()), row);
      }
      values.multiply(count, scores.data(), head.keys, y.data<T>() + at, s.channels);
    }
  });
}

/// With P the softmax: dV = P^T dY, dS = P (dP - sum dP P) scale with dP = dY V^T, dQ = dS K, dK = dS^T Q.
template <class T>
void attend_gradient(const Sizes& s, const Tensor& query, const Tensor& key, const Tensor& value,
                     const Tensor& dy, std::vector<Tensor>& grads) {
  const kernels::TransformerKernels<T>& k = kernels::transformer_kernels<T>();
  parallel_for(s.batch * s.heads, [&](int64_t unit) {
    const Head<T> head(s, unit);
    if (head.queries == 0) return;
    // Rows of a power of two would share few sets of the caches where they are read as columns.
    const int64_t stride = head.keys + 16;
    const kernels::PackedMatrix<T> keys = head.columns(key), values = head.columns(value),
                                   key_rows = head.rows(key);
    const kernels::Scratch<T> p(kQueries * stride), ds(kQueries * stride);
    for (int64_t begin = 0; begin < head.queries; begin += kQueries) {
      const int64_t count = std::min(kQueries, head.queries - begin), at = head.query_at + begin * s.channels;
      keys.multiply(count, query.data<T>() + at, s.channels, p.data(), stride);
      values.multiply(count, dy.data<T>() + at, s.channels, ds.data(), stride);
      for (int64_t i = 0; i < count; ++i) {
        T* const row = p.data() + i * stride;
        T* const gradient = ds.data() + i * stride;
        k.softmax(row, head.keys, static_cast<T>(s.scale()), row);
        k.softmax_gradient(row, gradient, head.keys, static_cast<T>(s.scale()), gradient);
      }
      key_rows.multiply(count, ds.data(), stride, grads[0].data<T>() + at, s.channels);
      add_transposed_product(count, head.keys, s.depth(), ds.data(), stride, query.data<T>() + at, s.channels,
                             begin > 0, grads[1].data<T>() + head.key_at);
      add_transposed_product(count, head.keys, s.depth(), p.data(), stride, dy.data<T>() + at, s.channels,
                             begin > 0, grads[2].data<T>() + head.key_at);
    }
  });
}

}  // namespace

Tensor scaled_dot_product_attention(const Tensor& query, const Tensor& key, const Tensor& value,
                                    const AttentionOptions& options) {
  constexpr std::string_view kName = "scaled_dot_product_attention";
  const std::shared_ptr<const ActiveSites> sites = common_sites(kName, std::vector{query, key, value});
  const int64_t rank = sites ? 2 : 3;
  if (query.dim() != rank || key.dim() != rank || value.shape() != key.shape() ||
      query.size(0) != key.size(0) || query.size(-1) != key.size(-1) || query.dtype() != key.dtype() ||
      query.dtype() != value.dtype()) {
    fail(kName,
         "query {} {}, key {} {} and value {} {} do not fit; expected N x L x C, N x S x C and N x S x C, or "
         "three times the same sites x C",
         to_string(query.dtype()), to_string(query.shape()), to_string(key.dtype()), to_string(key.shape()),
         to_string(value.dtype()), to_string(value.shape()));
  }
  Sizes s{sites ? sites->n() : query.size(0), query.size(-1), options.heads, {}, {}};
  for (int64_t image = 0; image <= s.batch; ++image) {
    s.first_query.push_back(sites ? sites->first(image) : image * query.size(1));
    s.first_key.push_back(sites ? sites->first(image) : image * key.size(1));
  }
  if (s.heads < 1 || s.channels % s.heads != 0 || s.channels == 0) {
    fail(kName, "{} channels do not divide into {} heads", s.channels, s.heads);
  }
  if (key.numel() == 0 && query.numel() > 0)
    fail(kName, "there are no keys (key {})", to_string(key.shape()));
  Tensor y(query.shape(), query.dtype());
  y.set_sites(sites);
  dispatch_floating(kName, query.dtype(), [&]<class T>() { attend<T>(s, query, key, value, y); });
  if (!should_record({&query, &key, &value})) return y;
  return record(
      kName, y, {query, key, value},
      [s, q = query.saved(), k = key.saved(), v = value.saved()](const Tensor& dy, std::span<const char>) {
        const Tensor q_values = q.restored(), k_values = k.restored(), v_values = v.restored();
        std::vector<Tensor> grads{Tensor(q.shape(), q.dtype()), Tensor::zeros(k.shape(), k.dtype()),
                                  Tensor::zeros(v.shape(), v.dtype())};
        dispatch_floating(kName, dy.dtype(),
                          [&]<class T>() { attend_gradient<T>(s, q_values, k_values, v_values, dy, grads); });
        return grads;
      });
}

}  // namespace opaline
