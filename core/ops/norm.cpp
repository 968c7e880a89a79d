#include "core/ops/norm.h"

#include <algorithm>
#include <cmath>
#include <vector>

#include "core/autograd.h"
#include "core/parallel.h"

namespace opaline {
namespace {

void check_channels(std::string_view operation, std::string_view what, const Tensor& tensor,
                    const Tensor& x) {
  if (tensor.shape() != Shape{x.size(-1)} || tensor.dtype() != x.dtype()) {
    fail(operation, "{} is {} {}, expected {} {} (input {})", what, to_string(tensor.dtype()),
         to_string(tensor.shape()), to_string(x.dtype()), x.size(-1), to_string(x.shape()));
  }
}

/// sums[k][j] = sum over rows of f(row, j)[k], in double: blocks of rows, joined in order. One group at a
/// time; `f` adds its terms for a row to `k` arrays of `columns`.
template <class F>
std::vector<double> row_sums(int64_t rows, int64_t columns, int64_t terms, const F& add_row) {
  constexpr int64_t kBlock = 512;
  const auto width = static_cast<size_t>(terms * columns);
  const int64_t blocks = (rows + kBlock - 1) / kBlock;
  std::vector<double> partial(static_cast<size_t>(blocks) * width, 0.0);
  parallel_for(blocks, [&](int64_t b) {
    double* const to = partial.data() + static_cast<size_t>(b) * width;
    for (int64_t row = b * kBlock; row < std::min(rows, (b + 1) * kBlock); ++row) add_row(row, to);
  });
  std::vector<double> total(width, 0.0);
  for (int64_t b = 0; b < blocks; ++b) {
    for (size_t j = 0; j < width; ++j) total[j] += partial[static_cast<size_t>(b) * width + j];
  }
  return total;
}

/// Mean and biased variance of each channel over `rows` rows. Values are shifted by the first row, so that a
/// variance far below the square of the mean survives a single pass.
template <class T>
void channel_statistics(const T* x, int64_t rows, int64_t columns, double* mean, double* variance) {
  const auto sums = row_sums(rows, columns, 2, [&](int64_t row, double* to) {
    const T* const v = x + row * columns;
    for (int64_t j = 0; j < columns; ++j) {
      const double d = static_cast<double>(v[j]) - static_cast<double>(x[j]);
      to[j] += d;
      to[columns + j] += d * d;
    }
  });
  const auto n = static_cast<double>(rows);
  for (int64_t j = 0; j < columns; ++j) {
    const double shifted = sums[static_cast<size_t>(j)] / n;
    mean[j] = static_cast<double>(x[j]) + shifted;
    const double v = sums[static_cast<size_t>(columns + j)] / n - shifted * shifted;
    variance[j] = v < 0.0 ? 0.0 : v;  // rounding; NaN passes
  }
}

/// y = (x - mean) * inverse * weight + offset for each channel; inverse = 1 / sqrt(var + eps). The two
/// factors stay apart: their product underflows where the values are huge and the weight is small.
template <class T>
void apply_channels(const T* x, int64_t rows, int64_t columns, const double* mean, const double* inverse,
                    const T* weight, const T* bias, T* y) {
  std::vector<T> center(static_cast<size_t>(columns)), scale(center.size()), factor(center.size()),
      offset(center.size());
  for (int64_t j = 0; j < columns; ++j) {
    const auto k = static_cast<size_t>(j);
    center[k] = static_cast<T>(mean[j]);
    scale[k] = static_cast<T>(inverse[j]);
    factor[k] = weight != nullptr ? weight[j] : T(1);
    // What rounding the mean to T lost goes into the offset.
    offset[k] = static_cast<T>((bias != nullptr ? static_cast<double>(bias[j]) : 0.0) +
                               (static_cast<double>(center[k]) - mean[j]) * inverse[j] *
                                   static_cast<double>(factor[k]));
  }
  const T* const c = center.data();
  const T* const s = scale.data();
  const T* const f = factor.data();
  const T* const o = offset.data();
  parallel_blocks(rows, std::max<int64_t>(1, 32768 / std::max<int64_t>(columns, 1)),
                  [&](int64_t begin, int64_t end) {
                    for (int64_t row = begin; row < end; ++row) {
                      const T* const from = x + row * columns;
                      T* const to = y + row * columns;
                      for (int64_t j = 0; j < columns; ++j) to[j] = (from[j] - c[j]) * s[j] * f[j] + o[j];
                    }
                  });
}

/// Gradients of a normalisation over rows. With xhat = (x - mean) * inverse:
/// dx = weight * inverse * (dy - mean(dy) - xhat * mean(dy * xhat)), without the means where the statistics
/// were constants (`through_statistics` false). sums receives [sum dy, sum dy * xhat] a channel.
template <class T>
void channel_gradient(const T* x, const T* dy, int64_t rows, int64_t columns, const double* mean,
                      const double* inverse, const T* weight, bool through_statistics,
                      std::vector<double>& sums, T* dx) {
  sums = row_sums(rows, columns, 2, [&](int64_t row, double* to) {
    const T* const v = x + row * columns;
    const T* const g = dy + row * columns;
    for (int64_t j = 0; j < columns; ++j) {
      const auto d = static_cast<double>(g[j]);
      to[j] += d;
      to[columns + j] += d * (static_cast<double>(v[j]) - mean[j]) * inverse[j];
    }
  });
  if (dx == nullptr) return;
  // dx = factor * scale * (dy - b * scale * (x - mean) - c), whose factors stay apart as in apply_channels.
  std::vector<T> center(static_cast<size_t>(columns)), scale(center.size()), factor(center.size()),
      b(center.size()), c(center.size());
  for (int64_t j = 0; j < columns; ++j) {
    const auto k = static_cast<size_t>(j);
    const auto n = static_cast<double>(rows);
    center[k] = static_cast<T>(mean[j]);
    scale[k] = static_cast<T>(inverse[j]);
    factor[k] = weight != nullptr ? weight[j] : T(1);
    b[k] = static_cast<T>(sums[static_cast<size_t>(columns + j)] / n);
    // What rounding the mean to T lost goes into the constant.
    c[k] = static_cast<T>(sums[k] / n + static_cast<double>(b[k]) *
                                            (static_cast<double>(center[k]) - mean[j]) * inverse[j]);
  }
  parallel_blocks(
      rows, std::max<int64_t>(1, 32768 / std::max<int64_t>(columns, 1)), [&](int64_t begin, int64_t end) {
        for (int64_t row = begin; row < end; ++row) {
          const T* const v = x + row * columns;
          const T* const g = dy + row * columns;
          T* const to = dx + row * columns;
          for (int64_t j = 0; j < columns; ++j) {
            const auto k = static_cast<size_t>(j);
            // Constant statistics have no gradient, whatever x is: 0 * NaN would be one.
            const T through = through_statistics ? b[k] * ((v[j] - center[k]) * scale[k]) + c[k] : T{};
            to[j] = (g[j] - through) * scale[k] * factor[k];
          }
        }
      });
}

template <class T>
Tensor to_tensor(const double* values, int64_t count) {
  Tensor result({count}, dtype_of<T>());
  std::transform(values, values + count, result.data<T>(), [](double v) { return static_cast<T>(v); });
  return result;
}

template <class T>
const T* data_or_null(const Tensor& tensor) {
  return tensor.defined() ? tensor.data<T>() : nullptr;
}

}  // namespace

Tensor layer_norm(const Tensor& x, const Tensor& weight, const Tensor& bias, double eps) {
  if (x.dim() < 1 || x.size(-1) < 1) fail("layer_norm", "input has shape {}", to_string(x.shape()));
  check_channels("layer_norm", "weight", weight, x);
  check_channels("layer_norm", "bias", bias, x);
  const int64_t columns = x.size(-1), rows = x.numel() / columns;
  std::vector<double> mean(static_cast<size_t>(rows)), inverse(mean.size());
  Tensor y(x.shape(), x.dtype());
  dispatch_floating("layer_norm", x.dtype(), [&]<class T>() {
    const T* const w = weight.data<T>();
    const T* const b = bias.data<T>();
    parallel_blocks(rows, 64, [&](int64_t begin, int64_t end) {
      for (int64_t row = begin; row < end; ++row) {
        const T* const from = x.data<T>() + row * columns;
        T* const to = y.data<T>() + row * columns;
        double total = 0.0, squares = 0.0;
        for (int64_t j = 0; j < columns; ++j) total += static_cast<double>(from[j]);
        const double m = total / static_cast<double>(columns);
        for (int64_t j = 0; j < columns; ++j) {
          const double d = static_cast<double>(from[j]) - m;
          squares += d * d;
        }
        const double i = 1.0 / std::sqrt(squares / static_cast<double>(columns) + eps);
        for (int64_t j = 0; j < columns; ++j) {
          to[j] = static_cast<T>((static_cast<double>(from[j]) - m) * i * static_cast<double>(w[j]) +
                                 static_cast<double>(b[j]));
        }
        mean[static_cast<size_t>(row)] = m;
        inverse[static_cast<size_t>(row)] = i;
      }
    });
  });
  if (!should_record({&x, &weight, &bias})) return y;
  return record(
      "layer_norm", y, {x, weight, bias},
      [x = x.detach(), weight = weight.detach(), mean = std::move(mean), inverse = std::move(inverse), rows,
       columns](const Tensor& dy, std::span<const char> needs) {
        std::vector<Tensor> grads(3);
        if (needs[0]) grads[0] = Tensor(x.shape(), x.dtype());
        dispatch_floating("layer_norm", dy.dtype(), [&]<class T>() {
          const auto n = static_cast<double>(columns);
          if (needs[0]) {
            parallel_blocks(rows, 64, [&](int64_t begin, int64_t end) {
              for (int64_t row = begin; row < end; ++row) {
                const T* const v = x.data<T>() + row * columns;
                const T* const g = dy.data<T>() + row * columns;
                T* const to = grads[0].data<T>() + row * columns;
                const double m = mean[static_cast<size_t>(row)], i = inverse[static_cast<size_t>(row)];
                double sum_g = 0.0, sum_gx = 0.0;
                for (int64_t j = 0; j < columns; ++j) {
                  const double gw = static_cast<double>(g[j]) * static_cast<double>(weight.data<T>()[j]);
                  sum_g += gw;
                  sum_gx += gw * (static_cast<double>(v[j]) - m) * i;
                }
                for (int64_t j = 0; j < columns; ++j) {
                  const double gw = static_cast<double>(g[j]) * static_cast<double>(weight.data<T>()[j]);
                  const double xhat = (static_cast<double>(v[j]) - m) * i;
                  to[j] = static_cast<T>(i * (gw - sum_g / n - xhat * sum_gx / n));
                }
              }
            });
          }
          if (needs[1] || needs[2]) {
            const auto sums = row_sums(rows, columns, 2, [&](int64_t row, double* to) {
              const T* const v = x.data<T>() + row * columns;
              const T* const g = dy.data<T>() + row * columns;
              const double m = mean[static_cast<size_t>(row)], i = inverse[static_cast<size_t>(row)];
              for (int64_t j = 0; j < columns; ++j) {
                to[j] += static_cast<double>(g[j]);
                to[columns + j] += static_cast<double>(g[j]) * (static_cast<double>(v[j]) - m) * i;
              }
            });
            grads[1] = to_tensor<T>(sums.data() + columns, columns);
            grads[2] = to_tensor<T>(sums.data(), columns);
          }
        });
        return grads;
      });
}

Tensor batch_norm(const Tensor& x, const Tensor& weight, const Tensor& bias, Tensor running_mean,
                  Tensor running_var, const BatchNormOptions& options) {
  if (x.dim() < 2) fail("batch_norm", "input has shape {}, expected .. x C", to_string(x.shape()));
  check_channels("batch_norm", "weight", weight, x);
  check_channels("batch_norm", "bias", bias, x);
  const bool tracked = running_mean.defined();
  if (tracked != running_var.defined()) fail("batch_norm", "needs both running statistics or none");
  if (!tracked && !options.training) fail("batch_norm", "evaluation needs running statistics");
  if (tracked) {
    check_channels("batch_norm", "running_mean", running_mean, x);
    check_channels("batch_norm", "running_var", running_var, x);
  }
  const int64_t columns = x.size(-1), rows = columns == 0 ? 0 : x.numel() / columns;
  if (options.training && rows < 1)
    fail("batch_norm", "input {} has no values to normalise", to_string(x.shape()));
  std::vector<double> mean(static_cast<size_t>(columns)), inverse(mean.size());
  Tensor y(x.shape(), x.dtype());
  dispatch_floating("batch_norm", x.dtype(), [&]<class T>() {
    if (options.training) {
      channel_statistics(x.data<T>(), rows, columns, mean.data(), inverse.data());
      if (tracked) {
        const auto n = static_cast<double>(rows);
        for (int64_t j = 0; j < columns; ++j) {
          T& m = running_mean.data<T>()[j];
          T& v = running_var.data<T>()[j];
          const auto k = static_cast<size_t>(j);
          m = static_cast<T>((1.0 - options.momentum) * static_cast<double>(m) + options.momentum * mean[k]);
          if (rows > 1) {
            v = static_cast<T>((1.0 - options.momentum) * static_cast<double>(v) +
                               options.momentum * inverse[k] * n / (n - 1.0));
          }
        }
      }
    } else {
      for (size_t k = 0; k < mean.size(); ++k) {
        mean[k] = static_cast<double>(running_mean.data<T>()[k]);
        inverse[k] = static_cast<double>(running_var.data<T>()[k]);
      }
    }
    for (double& v : inverse) v = 1.0 / std::sqrt(v + options.eps);
    apply_channels(x.data<T>(), rows, columns, mean.data(), inverse.data(), weight.data<T>(), bias.data<T>(),
                   y.data<T>());
  });
  if (!should_record({&x, &weight, &bias})) return y;
  return record(
      "batch_norm", y, {x, weight, bias},
      [x = x.detach(), weight = weight.detach(), mean = std::move(mean), inverse = std::move(inverse), rows,
       columns, training = options.training](const Tensor& dy, std::span<const char> needs) {
        std::vector<Tensor> grads(3);
        if (needs[0]) grads[0] = Tensor(x.shape(), x.dtype());
        dispatch_floating("batch_norm", dy.dtype(), [&]<class T>() {
          std::vector<double> sums;
          channel_gradient(x.data<T>(), dy.data<T>(), rows, columns, mean.data(), inverse.data(),
                           weight.data<T>(), training, sums, needs[0] ? grads[0].data<T>() : nullptr);
          grads[1] = to_tensor<T>(sums.data() + columns, columns);
          grads[2] = to_tensor<T>(sums.data(), columns);
        });
        return grads;
      });
}

Tensor instance_norm(const Tensor& x, const Tensor& weight, const Tensor& bias, double eps) {
  if (x.dim() != 4) fail("instance_norm", "input has shape {}, expected N x H x W x C", to_string(x.shape()));
  if (weight.defined() != bias.defined()) fail("instance_norm", "needs both weight and bias or none");
  if (weight.defined()) {
    check_channels("instance_norm", "weight", weight, x);
    check_channels("instance_norm", "bias", bias, x);
  }
  const int64_t images = x.size(0), rows = x.size(1) * x.size(2), columns = x.size(3);
  if (x.numel() == 0) fail("instance_norm", "input {} has no values to normalise", to_string(x.shape()));
  std::vector<double> mean(static_cast<size_t>(images * columns)), inverse(mean.size());
  Tensor y(x.shape(), x.dtype());
  dispatch_floating("instance_norm", x.dtype(), [&]<class T>() {
    for (int64_t i = 0; i < images; ++i) {
      const int64_t at = i * rows * columns;
      channel_statistics(x.data<T>() + at, rows, columns, mean.data() + i * columns,
                         inverse.data() + i * columns);
      for (int64_t j = i * columns; j < (i + 1) * columns; ++j) {
        inverse[static_cast<size_t>(j)] = 1.0 / std::sqrt(inverse[static_cast<size_t>(j)] + eps);
      }
      apply_channels(x.data<T>() + at, rows, columns, mean.data() + i * columns, inverse.data() + i * columns,
                     data_or_null<T>(weight), data_or_null<T>(bias), y.data<T>() + at);
    }
  });
  if (!should_record({&x, &weight, &bias})) return y;
  return record(
      "instance_norm", y, {x, weight, bias},
      [x = x.detach(), weight = weight.defined() ? weight.detach() : Tensor(), mean = std::move(mean),
       inverse = std::move(inverse), images, rows, columns](const Tensor& dy, std::span<const char> needs) {
        std::vector<Tensor> grads(3);
        if (needs[0]) grads[0] = Tensor(x.shape(), x.dtype());
        dispatch_floating("instance_norm", dy.dtype(), [&]<class T>() {
          std::vector<double> total(static_cast<size_t>(2 * columns), 0.0), sums;
          for (int64_t i = 0; i < images; ++i) {
            const int64_t at = i * rows * columns;
            channel_gradient(x.data<T>() + at, dy.data<T>() + at, rows, columns, mean.data() + i * columns,
                             inverse.data() + i * columns, data_or_null<T>(weight), true, sums,
                             needs[0] ? grads[0].data<T>() + at : nullptr);
            for (size_t j = 0; j < total.size(); ++j) total[j] += sums[j];
          }
          if (needs[1]) grads[1] = to_tensor<T>(total.data() + columns, columns);
          if (needs[2]) grads[2] = to_tensor<T>(total.data(), columns);
        });
        return grads;
      });
}

}  // namespace opaline
