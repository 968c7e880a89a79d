#include "core/kernels/conv.h"

#include <algorithm>

#include "core/kernels/direct.h"
#include "core/kernels/scratch.h"
#include "core/kernels/winograd.h"
#include "core/parallel.h"

namespace opaline::kernels {

namespace {

/// The parts next to each other, for algorithms that read one array: that of a single part itself.
template <class T>
class Joined {
 public:
  Joined(const ConvShape& s, Parts<const T> parts) : copy_(parts.size() == 1 ? 0 : s.n * s.h * s.w * s.in) {
    data_ = parts.front().data;
    if (parts.size() == 1) return;
    data_ = copy_.data();
    int64_t first = 0;
    for (const Part<const T>& part : parts) {
      copy_channels(part.data, part.channels, copy_.data() + first, s.in, part.channels, s.n * s.h * s.w);
      first += part.channels;
    }
  }
  const T* data() const { return data_; }

  /// Copies `count` channels of each pixel between arrays whose pixels are some elements apart.
  static void copy_channels(const T* from, int64_t from_stride, T* to, int64_t to_stride, int64_t count,
                            int64_t pixels) {
    parallel_blocks(pixels, 1024, [&](int64_t begin, int64_t end) {
      for (int64_t i = begin; i < end; ++i) std::copy_n(from + i * from_stride, count, to + i * to_stride);
    });
  }

 private:
  Scratch<T> copy_;
  const T* data_;
};

}  // namespace

template <class T>
void conv_forward(const ConvShape& s, ConvPlan& plan, Parts<const T> x, const T* weight, const T* bias,
                  T* y) {
  const int outputs = plan.outputs(s, ConvPass::kForward);
  if (outputs == 0) return direct_forward(s, Joined<T>(s, x).data(), weight, bias, y);
  if (winograd_takes(x)) return winograd_forward(outputs, s, x, weight, bias, y);
  const Joined<T> joined(s, x);
  const Part<const T> whole{joined.data(), s.in};
  winograd_forward(outputs, s, Parts<const T>(&whole, 1), weight, bias, y);
}

template <class T>
void conv_input_gradient(const ConvShape& s, ConvPlan& plan, const T* dy, const T* weight, const T* bias,
                         Parts<T> dx) {
  const int outputs = plan.outputs(s, ConvPass::kInputGradient);
  if (outputs > 0 && !s.reflect && winograd_takes(dx)) {
    return winograd_input_gradient(outputs, s, dy, weight, bias, dx);
  }
  const auto run = [&](T* to) {
    const Part<T> whole{to, s.in};
    if (outputs == 0) return direct_input_gradient(s, dy, weight, bias, to);
    winograd_input_gradient(outputs, s, dy, weight, bias, Parts<T>(&whole, 1));
  };
  const auto run_folded = [&](T* to) {
    if (!s.reflect) return run(to);
    const int64_t h = s.h + 2 * s.padding, w = s.w + 2 * s.padding;
    const Scratch<T> padded(s.n * h * w * s.in);
    run(padded.data());
    fold_reflection(Image<T>{padded.data(), s.n, h, w, s.in}, s.padding, to);
  };
  if (dx.size() == 1) return run_folded(dx.front().data);
  const Scratch<T> whole(s.n * s.h * s.w * s.in);
  run_folded(whole.data());
  int64_t first = 0;
  for (const Part<T>& part : dx) {
    if (part.data != nullptr) {
      Joined<T>::copy_channels(whole.data() + first, s.in, part.data, part.channels, part.channels,
                               s.n * s.h * s.w);
    }
    first += part.channels;
  }
}

template <class T>
void conv_weight_gradient(const ConvShape& s, ConvPlan& plan, Parts<const T> x, const T* dy, T* dweight) {
  const int outputs = plan.outputs(s, ConvPass::kWeightGradient);
  if (outputs == 0) return direct_weight_gradient(s, Joined<T>(s, x).data(), dy, dweight);
  if (winograd_takes(x)) return winograd_weight_gradient(outputs, s, x, dy, dweight);
  const Joined<T> joined(s, x);
  const Part<const T> whole{joined.data(), s.in};
  winograd_weight_gradient(outputs, s, Parts<const T>(&whole, 1), dy, dweight);
}

template <class T>
void fold_reflection(const Image<T>& padded, int64_t padding, T* dx) {
  const int64_t h = padded.h - 2 * padding, w = padded.w - 2 * padding, c = padded.channels;
  // The padded rows that show row i: itself and up to two mirrored ones.
  struct Sources {
    int64_t at[3];
    int count;
  };
  const auto sources = [padding](int64_t i, int64_t size) {
    Sources result{{i + padding, 0, 0}, 1};
    if (i >= 1 && i <= padding) result.at[result.count++] = padding - i;
    const int64_t beyond = 2 * (size - 1) - i;  // the mirror image at the far end
    if (beyond >= size && beyond < size + padding) result.at[result.count++] = beyond + padding;
    return result;
  };
  parallel_blocks(padded.n * h, 4, [&](int64_t begin, int64_t end) {
    for (int64_t i = begin; i < end; ++i) {
      const Sources rows = sources(i % h, h);
      for (int r = 0; r < rows.count; ++r) {
        const T* const from = padded.pixel(i / h, rows.at[r], 0);
        T* const line = dx + i * w * c;
        if (r == 0) {
          std::copy_n(from + padding * c, w * c, line);
        } else {
          for (int64_t k = 0; k < w * c; ++k) line[k] += from[padding * c + k];
        }
        const auto add_mirrored = [&](int64_t j) {
          const Sources columns = sources(j, w);
          for (int q = 1; q < columns.count; ++q) {
            for (int64_t k = 0; k < c; ++k) line[j * c + k] += from[columns.at[q] * c + k];
          }
        };
        const int64_t near = std::min(padding + 1, w);
        for (int64_t j = 0; j < near; ++j) add_mirrored(j);
        for (int64_t j = std::max(near, w - 1 - padding); j < w; ++j) add_mirrored(j);
      }
    }
  });
}

template void conv_forward(const ConvShape&, ConvPlan&, Parts<const float>, const float*, const float*,
                           float*);
template void conv_forward(const ConvShape&, ConvPlan&, Parts<const double>, const double*, const double*,
                           double*);
template void conv_input_gradient(const ConvShape&, ConvPlan&, const float*, const float*, const float*,
                                  Parts<float>);
template void conv_input_gradient(const ConvShape&, ConvPlan&, const double*, const double*, const double*,
                                  Parts<double>);
template void conv_weight_gradient(const ConvShape&, ConvPlan&, Parts<const float>, const float*, float*);
template void conv_weight_gradient(const ConvShape&, ConvPlan&, Parts<const double>, const double*, double*);
template void fold_reflection(const Image<float>&, int64_t, float*);
template void fold_reflection(const Image<double>&, int64_t, double*);

}  // namespace opaline::kernels
