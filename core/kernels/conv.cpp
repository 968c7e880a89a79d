#include "core/kernels/conv.h"

#include <algorithm>
#include <vector>

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
  Joined(int64_t pixels, int64_t channels, Parts<const T> parts)
      : copy_(parts.size() == 1 ? 0 : pixels * channels) {
    data_ = parts.front().data;
    if (parts.size() == 1) return;
    data_ = copy_.data();
    int64_t first = 0;
    for (const Part<const T>& part : parts) {
      copy_channels(part.data, part.channels, copy_.data() + first, channels, part.channels, pixels);
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

/// The convolution of those input channels alone whose parts have data.
template <class T>
struct WantedChannels {
  WantedChannels(const ConvShape& s, const T* all_weights, const T* all_bias, Parts<T> dx) : shape(s) {
    shape.in = 0;
    for (const Part<T>& part : dx) {
      if (part.data == nullptr) continue;
      parts.push_back(part);
      shape.in += part.channels;
    }
    const int64_t taps = s.kernel_h * s.kernel_w;
    weight.resize(static_cast<size_t>(s.out * shape.in * taps));
    T* to = weight.data();
    for (int64_t out = 0; out < s.out; ++out) {
      const T* from = all_weights + out * s.in * taps;
      for (const Part<T>& part : dx) {
        if (part.data != nullptr) to = std::copy_n(from, part.channels * taps, to);
        from += part.channels * taps;
      }
    }
    if (all_bias == nullptr) return;
    for (const Part<T>& part : dx) {
      if (part.data != nullptr) bias.insert(bias.end(), all_bias, all_bias + part.channels);
      all_bias += part.channels;
    }
  }
  const T* bias_data() const { return bias.empty() ? nullptr : bias.data(); }

  ConvShape shape;
  std::vector<Part<T>> parts;
  std::vector<T> weight, bias;
};

int64_t input_pixels(const ConvShape& s, const ConvSites& sites) {
  return sites.x == nullptr ? s.n * s.h * s.w : sites.x->count();
}

/// A convolution whose kernel is one pixel sees no neighbours: of a list of pixels it is one of a single row.
bool is_pointwise(const ConvShape& s) {
  return s.kernel_h == 1 && s.kernel_w == 1 && s.stride == 1 && s.padding == 0;
}

ConvShape as_row(const ConvShape& s, const ConvSites& sites) {
  ConvShape row = s;
  row.n = row.h = 1;
  row.w = sites.x->count();
  return row;
}

}  // namespace

template <class T>
void conv_forward(const ConvShape& s, ConvPlan& plan, Parts<const T> x, const T* weight, const T* bias, T* y,
                  const ConvSites& sites) {
  const int outputs = plan.outputs(s, ConvPass::kForward);
  if (outputs > 0 && winograd_takes(x)) return winograd_forward(outputs, s, x, weight, bias, y, sites);
  const Joined<T> joined(input_pixels(s, sites), s.in, x);
  if (outputs == 0) {
    if (sites.x != nullptr && is_pointwise(s)) {
      return direct_forward(as_row(s, sites), joined.data(), weight, bias, y);
    }
    return direct_forward(s, joined.data(), weight, bias, y, sites);
  }
  const Part<const T> whole{joined.data(), s.in};
  winograd_forward(outputs, s, Parts<const T>(&whole, 1), weight, bias, y, sites);
}

template <class T>
void conv_input_gradient(const ConvShape& s, ConvPlan& plan, const T* dy, const T* weight, const T* bias,
                         Parts<T> dx, const ConvSites& sites) {
  const auto is_wanted = [](const Part<T>& part) { return part.data != nullptr; };
  if (!std::all_of(dx.begin(), dx.end(), is_wanted)) {
    const WantedChannels<T> wanted(s, weight, bias, dx);
    if (wanted.parts.empty()) return;
    return conv_input_gradient(wanted.shape, plan, dy, wanted.weight.data(), wanted.bias_data(),
                               Parts<T>(wanted.parts), sites);
  }
  const int outputs = plan.outputs(s, ConvPass::kInputGradient);
  if (outputs > 0 && !s.reflect && winograd_takes(dx)) {
    return winograd_input_gradient(outputs, s, dy, weight, bias, dx, sites);
  }
  const auto run = [&](T* to, const ActiveSites* x_sites) {
    const Part<T> whole{to, s.in};
    if (outputs > 0) {
      return winograd_input_gradient(outputs, s, dy, weight, bias, Parts<T>(&whole, 1), {x_sites, sites.y});
    }
    if (sites.x != nullptr && is_pointwise(s)) {
      return direct_input_gradient(as_row(s, sites), dy, weight, bias, to);
    }
    direct_input_gradient(s, dy, weight, bias, to, {x_sites, sites.y});
  };
  const auto run_folded = [&](T* to) {
    if (!s.reflect) return run(to, sites.x);
    const int64_t h = s.h + 2 * s.padding, w = s.w + 2 * s.padding;
    if (sites.x == nullptr) {
      const Scratch<T> padded(s.n * h * w * s.in);
      run(padded.data(), nullptr);
      return fold_reflection(Image<T>{padded.data(), s.n, h, w, s.in}, s.padding, to);
    }
    const ActiveSites padded_sites = sites.x->mirrored(s.padding);
    const Scratch<T> padded(padded_sites.count() * s.in);
    run(padded.data(), &padded_sites);
    fold_reflection(Image<T>{padded.data(), s.n, h, w, s.in, 0, &padded_sites}, s.padding, to, sites.x);
  };
  if (dx.size() == 1) return run_folded(dx.front().data);
  const int64_t pixels = input_pixels(s, sites);
  const Scratch<T> whole(pixels * s.in);
  run_folded(whole.data());
  int64_t first = 0;
  for (const Part<T>& part : dx) {
    Joined<T>::copy_channels(whole.data() + first, s.in, part.data, part.channels, part.channels, pixels);
    first += part.channels;
  }
}

template <class T>
void conv_weight_gradient(const ConvShape& s, ConvPlan& plan, Parts<const T> x, const T* dy, T* dweight,
                          const ConvSites& sites) {
  const int outputs = plan.outputs(s, ConvPass::kWeightGradient);
  if (outputs > 0 && winograd_takes(x)) return winograd_weight_gradient(outputs, s, x, dy, dweight, sites);
  const Joined<T> joined(input_pixels(s, sites), s.in, x);
  if (outputs == 0) {
    if (sites.x != nullptr && is_pointwise(s)) {
      return direct_weight_gradient(as_row(s, sites), joined.data(), dy, dweight);
    }
    return direct_weight_gradient(s, joined.data(), dy, dweight, sites);
  }
  const Part<const T> whole{joined.data(), s.in};
  winograd_weight_gradient(outputs, s, Parts<const T>(&whole, 1), dy, dweight, sites);
}

template <class T>
void fold_reflection(const Image<T>& padded, int64_t padding, T* dx, const ActiveSites* sites) {
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
  if (sites != nullptr) {
    parallel_blocks(padded.n * h, 4, [&](int64_t begin, int64_t end) {
      for (int64_t i = begin; i < end; ++i) {
        const Sources rows = sources(i % h, h);
        for (int64_t j = 0; j < w; ++j) {
          const int64_t site = sites->site(i / h, i % h, j);
          if (site < 0) continue;
          const Sources columns = sources(j, w);
          T* const to = dx + site * c;
          std::fill_n(to, c, T{});
          for (int r = 0; r < rows.count; ++r) {
            for (int q = 0; q < columns.count; ++q) {
              const T* const from = padded.pixel(i / h, rows.at[r], columns.at[q]);
              for (int64_t k = 0; k < c; ++k) to[k] += from[k];
            }
          }
        }
      }
    });
    return;
  }
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
                           float*, const ConvSites&);
template void conv_forward(const ConvShape&, ConvPlan&, Parts<const double>, const double*, const double*,
                           double*, const ConvSites&);
template void conv_input_gradient(const ConvShape&, ConvPlan&, const float*, const float*, const float*,
                                  Parts<float>, const ConvSites&);
template void conv_input_gradient(const ConvShape&, ConvPlan&, const double*, const double*, const double*,
                                  Parts<double>, const ConvSites&);
template void conv_weight_gradient(const ConvShape&, ConvPlan&, Parts<const float>, const float*, float*,
                                   const ConvSites&);
template void conv_weight_gradient(const ConvShape&, ConvPlan&, Parts<const double>, const double*, double*,
                                   const ConvSites&);
template void fold_reflection(const Image<float>&, int64_t, float*, const ActiveSites*);
template void fold_reflection(const Image<double>&, int64_t, double*, const ActiveSites*);

}  // namespace opaline::kernels
