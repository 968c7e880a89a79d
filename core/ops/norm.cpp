#include "core/ops/norm.h"

#include <algorithm>
#include <cmath>
#include <memory>
#include <vector>

#include "core/autograd.h"
#include "core/kernels/norm.h"
#include "core/ops/sites.h"
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

/// What batch and instance norm share: the values of a channel in a group of rows (all of the batch, or one
/// image) are normalised together, by statistics that are kept for the backward pass.
class ChannelNorm {
 public:
  /// `first`: the first row of each group, and the number of all rows.
  ChannelNorm(std::string_view operation, std::vector<int64_t> first, int64_t columns, bool relu)
      : operation_(operation),
        first_(std::move(first)),
        groups_(static_cast<int64_t>(first_.size()) - 1),
        columns_(columns),
        relu_(relu),
        mean_(static_cast<size_t>(groups_ * columns)),
        inverse_(mean_.size()) {}

  double& mean(int64_t i) { return mean_[static_cast<size_t>(i)]; }
  /// The biased variance, until prepare() turns it into 1 / sqrt(variance + eps).
  double& variance(int64_t i) { return inverse_[static_cast<size_t>(i)]; }

  /// Mean and biased variance of x. Values are shifted by the first row, so that a variance far below the
  /// square of the mean survives a single pass.
  template <class T>
  void measure(const T* x) {
    for (int64_t g = 0; g < groups_; ++g) {
      if (rows(g) == 0) continue;
      const auto n = static_cast<double>(rows(g));
      const T* const group = x + first(g) * columns_;
      const std::vector<double> sums = sum_rows<T>(g, 2, [&](int64_t begin, int64_t count, double* to) {
        kernels::norm_kernels<T>().moments(group + begin * columns_, count, columns_, group, to);
      });
      for (int64_t j = 0; j < columns_; ++j) {
        const double shifted = sums[static_cast<size_t>(j)] / n;
        mean(g * columns_ + j) = static_cast<double>(group[j]) + shifted;
        const double v = sums[sums.size() / 2 + static_cast<size_t>(j)] / n - shifted * shifted;
        variance(g * columns_ + j) = v < 0.0 ? 0.0 : v;  // rounding; NaN passes
      }
    }
  }

  /// The coefficients of y = (x - center) * scale * factor + offset. `weight` and `bias` may be null.
  template <class T>
  void prepare(double eps, const T* weight, const T* bias) {
    const int64_t count = groups_ * columns_;
    coefficients_ = Tensor({4, count}, dtype_of<T>());
    T* const center = coefficients_.data<T>();
    T* const scale = center + count;
    T* const factor = scale + count;
    T* const offset = factor + count;
    for (int64_t i = 0; i < count; ++i) {
      double& inverse = inverse_[static_cast<size_t>(i)];
      inverse = 1.0 / std::sqrt(inverse + eps);
      const int64_t j = i % columns_;
      center[i] = static_cast<T>(mean(i));
      scale[i] = static_cast<T>(inverse);
      factor[i] = weight != nullptr ? weight[j] : T(1);
      // What rounding the mean to T lost goes into the offset.
      offset[i] = static_cast<T>((bias != nullptr ? static_cast<double>(bias[j]) : 0.0) +
                                 (static_cast<double>(center[i]) - mean(i)) * inverse *
                                     static_cast<double>(factor[i]));
    }
  }

  Tensor apply(const Tensor& x) const {
    Tensor y(x.shape(), x.dtype());
    y.set_sites(x.sites());
    dispatch_floating(operation_, x.dtype(), [&]<class T>() {
      for_blocks<T>([&](int64_t group, int64_t at, int64_t count) {
        kernels::norm_kernels<T>().apply(x.data<T>() + at, count, columns_, map<T>(group), y.data<T>() + at);
      });
    });
    return y;
  }

  /// The gradients of x, weight and bias. With xhat = (x - mean) * inverse and g the gradient that the
  /// rectifier passes: dx = weight * inverse * (g - mean(g) - xhat * mean(g * xhat)), without the means where
  /// the statistics were constants (`through_statistics` false).
  std::vector<Tensor> gradients(const Tensor& x, const Tensor& dy, std::span<const char> needs,
                                bool through_statistics) const {
    std::vector<Tensor> grads(3);
    dispatch_floating(operation_, x.dtype(), [&]<class T>() {
      const kernels::NormKernels<T>& k = kernels::norm_kernels<T>();
      std::vector<double> total_weight(static_cast<size_t>(columns_), 0.0),
          total_bias(total_weight.size(), 0.0);
      std::vector<T> b(mean_.size()),
          c(mean_.size());  // means of g * xhat and of g: of a single value exactly g
      for (int64_t group = 0; group < groups_; ++group) {
        if (rows(group) == 0) continue;
        const int64_t at = first(group) * columns_;
        const std::vector<double> sums = sum_rows<T>(group, 2, [&](int64_t begin, int64_t count, double* to) {
          k.gradient_sums(x.data<T>() + at + begin * columns_, dy.data<T>() + at + begin * columns_, count,
                          columns_, map<T>(group), to);
        });
        const auto n = static_cast<double>(rows(group));
        for (int64_t j = 0; j < columns_; ++j) {
          const auto i = static_cast<size_t>(group * columns_ + j);
          const double sum = sums[static_cast<size_t>(j)];
          // What rounding the mean to T lost.
          const double shift = static_cast<double>(coefficients_.data<T>()[i]) - mean_[i];
          const double product = (sums[sums.size() / 2 + static_cast<size_t>(j)] + shift * sum) * inverse_[i];
          total_weight[static_cast<size_t>(j)] += product;
          total_bias[static_cast<size_t>(j)] += sum;
          b[i] = static_cast<T>(product / n);
          c[i] = static_cast<T>(sum / n + product / n * shift * inverse_[i]);
        }
      }
      if (needs[1]) grads[1] = to_tensor<T>(total_weight);
      if (needs[2]) grads[2] = to_tensor<T>(total_bias);
      if (!needs[0]) return;
      grads[0] = Tensor(x.shape(), x.dtype());
      for_blocks<T>([&](int64_t group, int64_t at, int64_t count) {
        const auto i = static_cast<size_t>(group * columns_);
        k.gradient(x.data<T>() + at, dy.data<T>() + at, count, columns_, map<T>(group),
                   through_statistics ? b.data() + i : nullptr, through_statistics ? c.data() + i : nullptr,
                   grads[0].data<T>() + at);
      });
    });
    return grads;
  }

 private:
  int64_t first(int64_t group) const { return first_[static_cast<size_t>(group)]; }
  int64_t rows(int64_t group) const { return first(group + 1) - first(group); }

  template <class T>
  kernels::ChannelMap<T> map(int64_t group) const {
    const int64_t count = groups_ * columns_;
    const T* const center = coefficients_.data<T>() + group * columns_;
    return {center, center + count, center + 2 * count, center + 3 * count, relu_};
  }

  /// `terms` padded arrays of sums over the rows of a group: blocks of rows, joined in order.
  template <class T, class F>
  std::vector<double> sum_rows(int64_t group, int64_t terms, const F& add_rows) const {
    constexpr int64_t kBlock = 512;
    const auto width = static_cast<size_t>(terms * kernels::norm_kernels<T>().padded(columns_));
    const int64_t blocks = (rows(group) + kBlock - 1) / kBlock;
    std::vector<double> partial(static_cast<size_t>(blocks) * width, 0.0);
    parallel_for(blocks, [&](int64_t block) {
      add_rows(block * kBlock, std::min(kBlock, rows(group) - block * kBlock),
               partial.data() + static_cast<size_t>(block) * width);
    });
    std::vector<double> total(width, 0.0);
    for (int64_t block = 0; block < blocks; ++block) {
      for (size_t j = 0; j < width; ++j) total[j] += partial[static_cast<size_t>(block) * width + j];
    }
    return total;
  }

  /// Calls f(group, first element, rows) for blocks of rows that fit the caches.
  template <class T, class F>
  void for_blocks(const F& f) const {
    struct Block {
      int64_t group, row, count;
    };
    const int64_t most = std::max<int64_t>(1, 32768 / std::max<int64_t>(columns_, 1));
    std::vector<Block> blocks;
    for (int64_t group = 0; group < groups_; ++group) {
      for (int64_t row = first(group); row < first(group + 1); row += most) {
        blocks.push_back({group, row, std::min(most, first(group + 1) - row)});
      }
    }
    parallel_for(static_cast<int64_t>(blocks.size()), [&](int64_t i) {
      const Block& block = blocks[static_cast<size_t>(i)];
      f(block.group, block.row * columns_, block.count);
    });
  }

  template <class T>
  static Tensor to_tensor(const std::vector<double>& values) {
    Tensor result({static_cast<int64_t>(values.size())}, dtype_of<T>());
    std::transform(values.begin(), values.end(), result.data<T>(),
                   [](double v) { return static_cast<T>(v); });
    return result;
  }

  std::string_view operation_;
  std::vector<int64_t> first_;
  int64_t groups_, columns_;
  bool relu_;
  std::vector<double> mean_, inverse_;
  Tensor coefficients_;  // 4 x (groups * columns): center, scale, factor, offset
};

/// y = norm(x), with its place in the graph.
Tensor finish(std::string_view operation, const std::shared_ptr<const ChannelNorm>& norm, const Tensor& x,
              const Tensor& weight, const Tensor& bias, bool through_statistics) {
  const Tensor y = norm->apply(x);
  if (!should_record({&x, &weight, &bias})) return y;
  const Tensor kept = x.saved();
  return record(
      operation, y, {x, weight, bias},
      [norm, kept, through_statistics](const Tensor& dy, std::span<const char> needs) {
        return norm->gradients(kept.restored(), dy, needs, through_statistics);
      },
      [norm, kept] { return norm->apply(kept.restored()); });
}

template <class T>
const T* data_or_null(const Tensor& tensor) {
  return tensor.defined() ? tensor.data<T>() : nullptr;
}

}  // namespace

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
  if (options.training && rows < 1 && !x.sites())
    fail("batch_norm", "input {} has no values to normalise", to_string(x.shape()));
  const auto norm =
      std::make_shared<ChannelNorm>("batch_norm", std::vector<int64_t>{0, rows}, columns, options.relu);
  dispatch_floating("batch_norm", x.dtype(), [&]<class T>() {
    if (options.training) norm->measure(x.data<T>());
    const auto n = static_cast<double>(rows);
    for (int64_t j = 0; j < columns; ++j) {
      if (!options.training) {
        norm->mean(j) = static_cast<double>(running_mean.data<T>()[j]);
        norm->variance(j) = static_cast<double>(running_var.data<T>()[j]);
      } else if (tracked && rows > 0 && !recomputing()) {
        T& m = running_mean.data<T>()[j];
        T& v = running_var.data<T>()[j];
        m = static_cast<T>((1.0 - options.momentum) * static_cast<double>(m) +
                           options.momentum * norm->mean(j));
        if (rows > 1) {
          v = static_cast<T>((1.0 - options.momentum) * static_cast<double>(v) +
                             options.momentum * norm->variance(j) * n / (n - 1.0));
        }
      }
    }
    norm->prepare(options.eps, weight.data<T>(), bias.data<T>());
  });
  return finish("batch_norm", norm, x, weight, bias, options.training);
}

Tensor instance_norm(const Tensor& x, const Tensor& weight, const Tensor& bias,
                     const InstanceNormOptions& options) {
  const ImageSize size = image_size("instance_norm", x);
  if (weight.defined() != bias.defined()) fail("instance_norm", "needs both weight and bias or none");
  if (weight.defined()) {
    check_channels("instance_norm", "weight", weight, x);
    check_channels("instance_norm", "bias", bias, x);
  }
  if (x.numel() == 0 && !x.sites()) {
    fail("instance_norm", "input {} has no values to normalise", to_string(x.shape()));
  }
  std::vector<int64_t> first;
  for (int64_t image = 0; image <= size.n; ++image) {
    first.push_back(x.sites() ? x.sites()->first(image) : image * size.h * size.w);
  }
  const auto norm = std::make_shared<ChannelNorm>("instance_norm", first, size.channels, options.relu);
  dispatch_floating("instance_norm", x.dtype(), [&]<class T>() {
    norm->measure(x.data<T>());
    norm->prepare(options.eps, data_or_null<T>(weight), data_or_null<T>(bias));
  });
  return finish("instance_norm", norm, x, weight, bias, true);
}

}  // namespace opaline
