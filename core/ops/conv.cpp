#include "core/ops/conv.h"

#include <algorithm>
#include <type_traits>
#include <vector>

#include "core/autograd.h"
#include "core/kernels/conv.h"
#include "core/kernels/gemm.h"
#include "core/ops/sites.h"
#include "core/parallel.h"

namespace opaline {
namespace {

void check_image(std::string_view operation, const Tensor& x) {
  if (x.dim() != 4) fail(operation, "input has shape {}, expected N x H x W x C", to_string(x.shape()));
}

void check_weight(std::string_view operation, const Tensor& x, int64_t channels, const Tensor& weight,
                  const Tensor& bias, int64_t in, int64_t out) {
  if (weight.dtype() != x.dtype()) {
    fail(operation, "input is {}, weight {}", to_string(x.dtype()), to_string(weight.dtype()));
  }
  if (channels != in) {
    fail(operation, "input has {} channels, weight expects {} (input {}, weight {})", channels, in,
         to_string(x.shape()), to_string(weight.shape()));
  }
  if (bias.defined() && (bias.shape() != Shape{out} || bias.dtype() != x.dtype())) {
    fail(operation, "bias is {} {}, expected {} {}", to_string(bias.dtype()), to_string(bias.shape()),
         to_string(x.dtype()), out);
  }
}

/// The gradient of a bias: dy summed over everything but the channels.
Tensor bias_gradient(const Tensor& dy) {
  const int64_t channels = dy.size(-1);
  std::vector<double> sums(static_cast<size_t>(channels));
  return dispatch_floating("conv2d", dy.dtype(), [&]<class T>() {
    kernels::column_sums(dy.data<T>(), dy.numel() / std::max<int64_t>(channels, 1), channels, sums.data());
    Tensor result({channels}, dy.dtype());
    std::transform(sums.begin(), sums.end(), result.data<T>(), [](double v) { return static_cast<T>(v); });
    return result;
  });
}

/// The parts of an image as kernels take them.
template <class T>
std::vector<kernels::Part<T>> channel_parts(std::span<const Tensor> parts) {
  std::vector<kernels::Part<T>> result;
  for (const Tensor& part : parts) {
    result.push_back({part.data<std::remove_const_t<T>>(), part.size(-1)});
  }
  return result;
}

/// The share of the pixels that exist, rounded up to sixteenths.
int64_t sixteenths_of(const std::shared_ptr<const ActiveSites>& sites) {
  if (!sites) return 16;
  const int64_t all = sites->n() * sites->h() * sites->w();
  return all == 0 ? 16 : (16 * sites->count() + all - 1) / all;
}

/// The sites of the result: the input's, or those of half the size.
std::shared_ptr<const ActiveSites> result_sites(const kernels::ConvShape& s,
                                                const std::shared_ptr<const ActiveSites>& sites) {
  if (!sites || (s.out_h() == s.h && s.out_w() == s.w && s.stride == 1)) return sites;
  if (s.stride == 2 && s.out_h() * 2 == s.h && s.out_w() * 2 == s.w) return sites->halved();
  fail("conv2d", "of active sites must keep or halve the image's size; {} gives {} x {}", to_string(s),
       s.out_h(), s.out_w());
}

}  // namespace

Tensor conv2d(const Tensor& x, const Tensor& weight, const Tensor& bias, const Conv2dOptions& options) {
  return conv2d(std::span(&x, 1), weight, bias, options);
}

Tensor conv2d(std::span<const Tensor> parts, const Tensor& weight, const Tensor& bias,
              const Conv2dOptions& options) {
  if (parts.empty()) fail("conv2d", "no input");
  const Tensor& x = parts.front();
  const ImageSize size = image_size("conv2d", x);
  const std::shared_ptr<const ActiveSites> x_sites = common_sites("conv2d", parts);
  int64_t channels = 0;
  for (const Tensor& part : parts) {
    if (!x_sites) check_image("conv2d", part);
    if (part.dtype() != x.dtype() ||
        !std::equal(x.shape().begin(), x.shape().end() - 1, part.shape().begin())) {
      fail("conv2d", "input parts {} {} and {} {} do not fit", to_string(x.dtype()), to_string(x.shape()),
           to_string(part.dtype()), to_string(part.shape()));
    }
    channels += part.size(-1);
  }
  if (weight.dim() != 4)
    fail("conv2d", "weight has shape {}, expected O x I x KH x KW", to_string(weight.shape()));
  check_weight("conv2d", x, channels, weight, bias, weight.size(1), weight.size(0));
  if (options.stride < 1 || options.padding < 0) {
    fail("conv2d", "stride {} and padding {}; expected at least 1 and 0", options.stride, options.padding);
  }
  const bool reflect = options.padding_mode == Padding::kReflect && options.padding > 0;
  if (reflect && (options.padding >= size.h || options.padding >= size.w)) {
    fail("reflection_pad2d", "padding {} needs 0 <= padding < height and width (input {})", options.padding,
         to_string(x.shape()));
  }
  const kernels::ConvShape s{.n = size.n,
                             .h = size.h,
                             .w = size.w,
                             .in = channels,
                             .out = weight.size(0),
                             .kernel_h = weight.size(2),
                             .kernel_w = weight.size(3),
                             .stride = options.stride,
                             .padding = options.padding,
                             .reflect = reflect,
                             .sixteenths = sixteenths_of(x_sites)};
  if (s.h + 2 * s.padding < s.kernel_h || s.w + 2 * s.padding < s.kernel_w) {
    fail("conv2d", "input {} with padding {} is smaller than the kernel {}x{}", to_string(x.shape()),
         s.padding, s.kernel_h, s.kernel_w);
  }
  const std::shared_ptr<kernels::ConvPlan> plan = current_conv_plan();
  const std::shared_ptr<const ActiveSites> y_sites = result_sites(s, x_sites);
  Tensor y(y_sites ? Shape{y_sites->count(), s.out} : Shape{s.n, s.out_h(), s.out_w(), s.out}, x.dtype());
  y.set_sites(y_sites);
  dispatch_floating("conv2d", x.dtype(), [&]<class T>() {
    kernels::conv_forward<T>(s, *plan, channel_parts<const T>(parts), weight.data<T>(),
                             bias.defined() ? bias.data<T>() : nullptr, y.data<T>(),
                             {partial(x_sites), partial(y_sites)});
  });
  std::vector<Tensor> inputs(parts.begin(), parts.end());
  inputs.insert(inputs.end(), {weight, bias});
  if (!should_record(inputs)) return y;
  std::vector<Tensor> kept;
  for (const Tensor& part : parts) kept.push_back(part.saved());
  return record(
      "conv2d", y, inputs,
      [s, plan, x_sites, y_sites, kept = std::move(kept), weight = weight.detach()](
          const Tensor& dy, std::span<const char> needs) {
        const size_t count = kept.size();
        const kernels::ConvSites sites{partial(x_sites), partial(y_sites)};
        std::vector<Tensor> grads(count + 2);
        dispatch_floating("conv2d", dy.dtype(), [&]<class T>() {
          if (std::any_of(needs.begin(), needs.end() - 2, [](char needed) { return needed != 0; })) {
            std::vector<kernels::Part<T>> dx;
            for (size_t i = 0; i < count; ++i) {
              if (needs[i]) grads[i] = Tensor(kept[i].shape(), dy.dtype());
              dx.push_back({needs[i] ? grads[i].data<T>() : nullptr, kept[i].size(-1)});
            }
            kernels::conv_input_gradient<T>(s, *plan, dy.data<T>(), weight.data<T>(), nullptr, dx, sites);
          }
          if (needs[count]) {
            std::vector<Tensor> values;
            for (const Tensor& part : kept) values.push_back(part.restored());
            grads[count] = Tensor(weight.shape(), weight.dtype());
            kernels::conv_weight_gradient<T>(s, *plan, channel_parts<const T>(values), dy.data<T>(),
                                             grads[count].data<T>(), sites);
          }
        });
        if (needs[count + 1]) grads[count + 1] = bias_gradient(dy);
        return grads;
      });
}

// The forward pass is the input gradient of a convolution whose input is this one's output, and the other way
// round; hence the same three kernels with x and y exchanged.
Tensor conv_transpose2d(const Tensor& x, const Tensor& weight, const Tensor& bias,
                        const ConvTranspose2dOptions& options) {
  check_image("conv_transpose2d", x);
  if (weight.dim() != 4) {
    fail("conv_transpose2d", "weight has shape {}, expected I x O x KH x KW", to_string(weight.shape()));
  }
  check_weight("conv_transpose2d", x, x.size(3), weight, bias, weight.size(0), weight.size(1));
  if (options.stride < 1 || options.padding < 0) {
    fail("conv_transpose2d", "stride {} and padding {}; expected at least 1 and 0", options.stride,
         options.padding);
  }
  const int64_t out_h = (x.size(1) - 1) * options.stride - 2 * options.padding + weight.size(2);
  const int64_t out_w = (x.size(2) - 1) * options.stride - 2 * options.padding + weight.size(3);
  if (out_h < 1 || out_w < 1) {
    fail("conv_transpose2d", "input {} with stride {} and padding {} gives an output of {}x{}",
         to_string(x.shape()), options.stride, options.padding, out_h, out_w);
  }
  const kernels::ConvShape s{.n = x.size(0),
                             .h = out_h,
                             .w = out_w,
                             .in = weight.size(1),
                             .out = weight.size(0),
                             .kernel_h = weight.size(2),
                             .kernel_w = weight.size(3),
                             .stride = options.stride,
                             .padding = options.padding};
  const std::shared_ptr<kernels::ConvPlan> plan = current_conv_plan();
  Tensor y({s.n, s.h, s.w, s.in}, x.dtype());
  dispatch_floating("conv_transpose2d", x.dtype(), [&]<class T>() {
    const kernels::Part<T> whole{y.data<T>(), s.in};
    kernels::conv_input_gradient<T>(s, *plan, x.data<T>(), weight.data<T>(),
                                    bias.defined() ? bias.data<T>() : nullptr, {&whole, 1});
  });
  if (!should_record({&x, &weight, &bias})) return y;
  return record(
      "conv_transpose2d", y, {x, weight, bias},
      [s, plan, kept = x.saved(), weight = weight.detach()](const Tensor& dy, std::span<const char> needs) {
        const Tensor input = needs[1] ? kept.restored() : kept;
        std::vector<Tensor> grads(3);
        dispatch_floating("conv_transpose2d", dy.dtype(), [&]<class T>() {
          const kernels::Part<const T> gradient{dy.data<T>(), s.in};
          if (needs[0]) {
            grads[0] = Tensor(input.shape(), input.dtype());
            kernels::conv_forward<T>(s, *plan, {&gradient, 1}, weight.data<T>(), nullptr, grads[0].data<T>());
          }
          if (needs[1]) {
            grads[1] = Tensor(weight.shape(), weight.dtype());
            kernels::conv_weight_gradient<T>(s, *plan, {&gradient, 1}, input.data<T>(), grads[1].data<T>());
          }
        });
        if (needs[2]) grads[2] = bias_gradient(dy);
        return grads;
      });
}

Tensor reflection_pad2d(const Tensor& x, int64_t padding) {
  check_image("reflection_pad2d", x);
  const int64_t n = x.size(0), h = x.size(1), w = x.size(2), c = x.size(3), p = padding;
  if (p < 0 || p >= h || p >= w) {
    fail("reflection_pad2d", "padding {} needs 0 <= padding < height and width (input {})", p,
         to_string(x.shape()));
  }
  const int64_t out_h = h + 2 * p, out_w = w + 2 * p;
  Tensor y({n, out_h, out_w, c}, x.dtype());
  dispatch_floating("reflection_pad2d", x.dtype(), [&]<class T>() {
    const kernels::Image<T> image{x.data<T>(), n, h, w, c, p};
    parallel_blocks(n * out_h, 16, [&](int64_t begin, int64_t end) {
      for (int64_t i = begin; i < end; ++i) {
        image.copy_row(i / out_h, i % out_h - p, -p, out_w, y.data<T>() + i * out_w * c);
      }
    });
  });
  if (!should_record({&x})) return y;
  return record("reflection_pad2d", y, {x}, [n, h, w, c, p](const Tensor& dy, std::span<const char>) {
    Tensor dx({n, h, w, c}, dy.dtype());
    dispatch_floating("reflection_pad2d", dy.dtype(), [&]<class T>() {
      kernels::fold_reflection(kernels::Image<T>{dy.data<T>(), n, h + 2 * p, w + 2 * p, c}, p, dx.data<T>());
    });
    return std::vector<Tensor>{dx};
  });
}

}  // namespace opaline
