#include "core/ops/linear.h"

#include <algorithm>
#include <vector>

#include "core/autograd.h"
#include "core/kernels/gemm.h"
#include "core/parallel.h"

namespace opaline {

Tensor linear(const Tensor& x, const Tensor& weight, const Tensor& bias) {
  if (weight.dim() != 2) fail("linear", "weight has shape {}, expected out x in", to_string(weight.shape()));
  const int64_t out = weight.size(0), in = weight.size(1);
  if (x.dim() < 1 || x.size(-1) != in || x.dtype() != weight.dtype()) {
    fail("linear", "input {} {} does not fit weight {} {}", to_string(x.dtype()), to_string(x.shape()),
         to_string(weight.dtype()), to_string(weight.shape()));
  }
  if (bias.defined() && (bias.shape() != Shape{out} || bias.dtype() != x.dtype())) {
    fail("linear", "bias is {} {}, expected {} {}", to_string(bias.dtype()), to_string(bias.shape()),
         to_string(x.dtype()), out);
  }
  Shape shape = x.shape();
  shape.back() = out;
  const int64_t rows = in == 0 ? 0 : x.numel() / in;
  Tensor y(shape, x.dtype());
  y.set_sites(x.sites());
  dispatch_floating("linear", x.dtype(), [&]<class T>() {
    kernels::gemm<T>(rows, out, in, {x.data<T>(), in, 1}, {weight.data<T>(), 1, in},
                     bias.defined() ? bias.data<T>() : nullptr, y.data<T>());
  });
  if (!should_record({&x, &weight, &bias})) return y;
  return record("linear", y, {x, weight, bias},
                [rows, in, out, kept = x.saved(), weight = weight.detach()](const Tensor& dy,
                                                                            std::span<const char> needs) {
                  std::vector<Tensor> grads(3);
                  dispatch_floating("linear", dy.dtype(), [&]<class T>() {
                    if (needs[0]) {
                      grads[0] = Tensor(kept.shape(), dy.dtype());
                      kernels::gemm<T>(rows, in, out, {dy.data<T>(), out, 1}, {weight.data<T>(), in, 1},
                                       nullptr, grads[0].data<T>());
                    }
                    if (needs[1]) {
                      const Tensor input = kept.restored();
                      grads[1] = Tensor(weight.shape(), weight.dtype());
                      kernels::gemm_tn(out, in, rows, dy.data<T>(), input.data<T>(), grads[1].data<T>());
                    }
                    if (needs[2]) {
                      std::vector<double> sums(static_cast<size_t>(out));
                      kernels::column_sums(dy.data<T>(), rows, out, sums.data());
                      grads[2] = Tensor({out}, dy.dtype());
                      std::transform(sums.begin(), sums.end(), grads[2].data<T>(),
                                     [](double value) { return static_cast<T>(value); });
                    }
                  });
                  return grads;
                });
}

namespace {

template <class T>
kernels::MatrixView<T> view(const T* data, int64_t rows, int64_t columns, bool transpose) {
  return transpose ? kernels::MatrixView<T>{data, 1, rows} : kernels::MatrixView<T>{data, columns, 1};
}

/// The product of every pair of matrices, one owner each.
Tensor batched_product(const Tensor& a, bool transpose_a, const Tensor& b, bool transpose_b, Shape shape) {
  Tensor c(std::move(shape), a.dtype());
  const int64_t m = c.size(-2), n = c.size(-1), k = a.size(transpose_a ? -2 : -1);
  const int64_t count = m * n == 0 ? 0 : c.numel() / (m * n);
  dispatch_floating("matmul", a.dtype(), [&]<class T>() {
    const auto product = [&](int64_t i, bool parallel) {
      kernels::gemm<T>(m, n, k, view(a.data<T>() + i * m * k, m, k, transpose_a),
                       view(b.data<T>() + i * k * n, k, n, transpose_b), nullptr, c.data<T>() + i * m * n,
                       parallel);
    };
    if (count == 1) {
      product(0, true);
    } else {
      parallel_for(count, [&](int64_t i) { product(i, false); });
    }
  });
  return c;
}

}  // namespace

Tensor matmul(const Tensor& a, const Tensor& b, const MatmulOptions& options) {
  const bool ta = options.transpose_a, tb = options.transpose_b;
  if (a.dim() < 2 || b.dim() != a.dim() || a.dtype() != b.dtype() ||
      a.size(ta ? -2 : -1) != b.size(tb ? -1 : -2) ||
      !std::equal(a.shape().begin(), a.shape().end() - 2, b.shape().begin())) {
    fail("matmul", "cannot multiply {} {}{} and {} {}{}", to_string(a.dtype()), to_string(a.shape()),
         ta ? " (transposed)" : "", to_string(b.dtype()), to_string(b.shape()), tb ? " (transposed)" : "");
  }
  Shape shape = a.shape();
  shape[shape.size() - 2] = a.size(ta ? -1 : -2);
  shape[shape.size() - 1] = b.size(tb ? -2 : -1);
  const Tensor c = batched_product(a, ta, b, tb, shape);
  if (!should_record({&a, &b})) return c;
  return record(
      "matmul", c, {a, b},
      [kept_a = a.saved(), kept_b = b.saved(), ta, tb](const Tensor& dc, std::span<const char> needs) {
        const Tensor left = kept_a.restored(), right = kept_b.restored();
        std::vector<Tensor> grads(2);
        // With A' = op(a), B' = op(b): dA' = dC B'^T, dB' = A'^T dC, transposed back where op did.
        if (needs[0]) {
          grads[0] = ta ? batched_product(right, tb, dc, true, left.shape())
                        : batched_product(dc, false, right, !tb, left.shape());
        }
        if (needs[1]) {
          grads[1] = tb ? batched_product(dc, true, left, ta, right.shape())
                        : batched_product(left, !ta, dc, false, right.shape());
        }
        return grads;
      });
}

}  // namespace opaline
