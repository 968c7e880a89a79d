#include "core/ops/loss.h"

#include <cmath>
#include <vector>

#include "core/autograd.h"
#include "core/ops/arithmetic.h"
#include "core/ops/reduce.h"
#include "core/ops/sites.h"
#include "core/ops/unary.h"
#include "core/parallel.h"

namespace opaline {
namespace {

void check_pair(std::string_view operation, const Tensor& x, const Tensor& target) {
  if (x.shape() != target.shape() || x.dtype() != target.dtype()) {
    fail(operation, "input {} {}, target {} {}", to_string(x.dtype()), to_string(x.shape()),
         to_string(target.dtype()), to_string(target.shape()));
  }
}

void check_masked(std::string_view operation, const Tensor& x, const Tensor& target, const Tensor& mask) {
  check_pair(operation, x, target);
  common_sites(operation, std::vector{x, target, mask});
  if (x.dim() != 4 && !x.sites()) {
    fail(operation, "input has shape {}, expected N x H x W x C and a mask N x H x W x 1",
         to_string(x.shape()));
  }
  Shape expected = x.shape();
  expected.back() = 1;
  if (mask.dtype() != x.dtype() || mask.shape() != expected) {
    fail(operation, "input {} {} needs a mask {} of its type, got {} {}", to_string(x.dtype()),
         to_string(x.shape()), to_string(expected), to_string(mask.dtype()), to_string(mask.shape()));
  }
}

/// Mean over the images of the mean over each mask's pixels of a pixel's loss. `value(x, target)` is the loss
/// of one pixel, `gradient(x, target, scale, dx)` writes its derivative times scale. Pixels outside the mask
/// are never read, so nothing that stands there can reach the loss.
template <class Value, class Gradient>
Tensor masked_mean(std::string_view operation, const Tensor& x, const Tensor& target, const Tensor& mask,
                   const Value& value, const Gradient& gradient) {
  check_masked(operation, x, target, mask);
  const auto [n, h, w, c] = image_size(operation, x);
  std::vector<int64_t> first;  // pixel of each image, and the number of all
  for (int64_t image = 0; image <= n; ++image) {
    first.push_back(x.sites() ? x.sites()->first(image) : image * h * w);
  }
  std::vector<double> losses(static_cast<size_t>(n), 0.0), counts(losses.size(), 0.0);
  dispatch_floating(operation, x.dtype(), [&, channels = c]<class T>() {
    parallel_for(n, [&](int64_t image) {
      const auto k = static_cast<size_t>(image);
      double total = 0.0, count = 0.0;
      for (int64_t i = first[k]; i < first[k + 1]; ++i) {
        if (mask.data<T>()[i] == T{}) continue;
        total += value(x.data<T>() + i * channels, target.data<T>() + i * channels, channels);
        count += 1.0;
      }
      losses[k] = count > 0.0 ? total / count : 0.0;
      counts[k] = count;
    });
  });
  double total = 0.0;
  for (const double loss : losses) total += loss;
  const Tensor y = Tensor::scalar(n > 0 ? total / static_cast<double>(n) : 0.0, x.dtype());
  if (!should_record({&x})) return y;
  return record(operation, y, {x},
                [operation, x = x.detach(), target = target.detach(), mask = mask.detach(), counts, first,
                 images = n, channels = c, gradient](const Tensor& dy, std::span<const char>) {
                  Tensor dx = Tensor::zeros(x.shape(), x.dtype());
                  dispatch_floating(operation, x.dtype(), [&]<class T>() {
                    parallel_for(images, [&](int64_t image) {
                      const auto k = static_cast<size_t>(image);
                      if (!(counts[k] > 0.0)) return;
                      const double scale = dy.item() / (counts[k] * static_cast<double>(images));
                      for (int64_t i = first[k]; i < first[k + 1]; ++i) {
                        if (mask.data<T>()[i] == T{}) continue;
                        gradient(x.data<T>() + i * channels, target.data<T>() + i * channels, channels, scale,
                                 dx.data<T>() + i * channels);
                      }
                    });
                  });
                  return std::vector<Tensor>{dx};
                });
}

/// The parts of a cosine: x.t, |x| |t| and |x|^2.
struct Cosine {
  double dot = 0.0, squares = 0.0, denominator = 0.0;
  bool clamped = false;

  template <class T>
  Cosine(const T* x, const T* t, int64_t c) {
    double target_squares = 0.0;
    for (int64_t k = 0; k < c; ++k) {
      const auto a = static_cast<double>(x[k]), b = static_cast<double>(t[k]);
      dot += a * b;
      squares += a * a;
      target_squares += b * b;
    }
    const double product = std::sqrt(squares) * std::sqrt(target_squares);
    clamped = product < 1e-8;
    denominator = clamped ? 1e-8 : product;
  }
};

}  // namespace

Tensor masked_l1_loss(const Tensor& x, const Tensor& target, const Tensor& mask) {
  return masked_mean(
      "masked_l1_loss", x, target, mask,
      []<class T>(const T* a, const T* b, int64_t c) {
        double total = 0.0;
        for (int64_t k = 0; k < c; ++k)
          total += std::abs(static_cast<double>(a[k]) - static_cast<double>(b[k]));
        return total / static_cast<double>(c);
      },
      []<class T>(const T* a, const T* b, int64_t c, double scale, T* dx) {
        const auto step = static_cast<T>(scale / static_cast<double>(c));
        for (int64_t k = 0; k < c; ++k) {
          const T d = a[k] - b[k];
          dx[k] = d > T{} ? step : d < T{} ? -step : T{};
        }
      });
}

Tensor masked_mse_loss(const Tensor& x, const Tensor& target, const Tensor& mask) {
  return masked_mean(
      "masked_mse_loss", x, target, mask,
      []<class T>(const T* a, const T* b, int64_t c) {
        double total = 0.0;
        for (int64_t k = 0; k < c; ++k) {
          const double d = static_cast<double>(a[k]) - static_cast<double>(b[k]);
          total += d * d;
        }
        return total / static_cast<double>(c);
      },
      []<class T>(const T* a, const T* b, int64_t c, double scale, T* dx) {
        for (int64_t k = 0; k < c; ++k) {
          const double d = static_cast<double>(a[k]) - static_cast<double>(b[k]);
          dx[k] = static_cast<T>(2.0 * d * scale / static_cast<double>(c));
        }
      });
}

Tensor cosine_loss(const Tensor& x, const Tensor& target, const Tensor& mask) {
  return masked_mean(
      "cosine_loss", x, target, mask,
      []<class T>(const T* a, const T* b, int64_t c) {
        const Cosine cosine(a, b, c);
        return 1.0 - cosine.dot / cosine.denominator;
      },
      []<class T>(const T* a, const T* b, int64_t c, double scale, T* dx) {
        const Cosine cosine(a, b, c);
        // d(dot/(|a||b|))/da = b / (|a||b|) - a dot / (|a|^3 |b|); the second term is absent where the
        // denominator is the constant 1e-8. |a|^2 > 0 wherever the product exceeds it.
        const double along = cosine.clamped ? 0.0 : cosine.dot / cosine.squares;
        for (int64_t k = 0; k < c; ++k) {
          const double d =
              (static_cast<double>(b[k]) - along * static_cast<double>(a[k])) / cosine.denominator;
          dx[k] = static_cast<T>(-scale * d);
        }
      });
}

Tensor l1_loss(const Tensor& x, const Tensor& target) {
  check_pair("l1_loss", x, target);
  return mean(abs(sub(x, target.detach())));
}

Tensor mse_loss(const Tensor& x, const Tensor& target) {
  check_pair("mse_loss", x, target);
  return mean(square(sub(x, target.detach())));
}

}  // namespace opaline
