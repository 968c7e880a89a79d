#include "core/ops/sites.h"

#include <algorithm>
#include <vector>

#include "core/autograd.h"
#include "core/parallel.h"

namespace opaline {
namespace {

/// Calls f(rectangle, row of it) for every row of sites.
template <class F>
void for_rows(const ActiveSites& sites, const F& f) {
  const auto& rectangles = sites.rectangles();
  parallel_for(static_cast<int64_t>(rectangles.size()), [&](int64_t i) {
    const ActiveSites::Rectangle& r = rectangles[static_cast<size_t>(i)];
    for (int64_t row = 0; row < r.rows; ++row) f(r, row);
  });
}

template <class T>
void gather(const ActiveSites& sites, int64_t channels, const T* dense, T* values) {
  for_rows(sites, [&](const ActiveSites::Rectangle& r, int64_t row) {
    const int64_t pixel = (r.image * sites.h() + r.row + row) * sites.w() + r.column;
    std::copy_n(dense + pixel * channels, r.columns * channels, values + (r.site + row * r.line) * channels);
  });
}

template <class T>
void scatter(const ActiveSites& sites, int64_t channels, const T* values, T* dense) {
  for_rows(sites, [&](const ActiveSites::Rectangle& r, int64_t row) {
    const int64_t pixel = (r.image * sites.h() + r.row + row) * sites.w() + r.column;
    std::copy_n(values + (r.site + row * r.line) * channels, r.columns * channels, dense + pixel * channels);
  });
}

Tensor dense_copy(const Tensor& x, double fill) {
  const ActiveSites& sites = *x.sites();
  Tensor y = Tensor::full({sites.n(), sites.h(), sites.w(), x.size(1)}, fill, x.dtype());
  dispatch_floating("to_dense", x.dtype(),
                    [&]<class T>() { scatter(sites, x.size(1), x.data<T>(), y.data<T>()); });
  return y;
}

Tensor sites_copy(const Tensor& x, const std::shared_ptr<const ActiveSites>& sites) {
  Tensor y({sites->count(), x.size(3)}, x.dtype());
  dispatch_floating("select_sites", x.dtype(),
                    [&]<class T>() { gather(*sites, x.size(3), x.data<T>(), y.data<T>()); });
  return y.set_sites(sites);
}

}  // namespace

Tensor select_sites(const Tensor& x, const std::shared_ptr<const ActiveSites>& sites) {
  const ImageSize size = image_size("select_sites", x);
  if (size.n != sites->n() || size.h != sites->h() || size.w != sites->w() ||
      (x.sites() && !(*x.sites() == *sites))) {
    fail("select_sites", "input {} of {} images of {} x {}; sites of {} images of {} x {}",
         to_string(x.shape()), size.n, size.h, size.w, sites->n(), sites->h(), sites->w());
  }
  if (x.sites()) return x;
  const Tensor y = sites_copy(x, sites);
  if (!should_record({&x})) return y;
  return record(
      "select_sites", y, {x},
      [sites](const Tensor& dy, std::span<const char>) {
        Tensor values = dy.detach();
        return std::vector<Tensor>{dense_copy(values.set_sites(sites), 0.0)};
      },
      [kept = x.saved(), sites] { return sites_copy(kept.restored(), sites); });
}

Tensor to_dense(const Tensor& x, double fill) {
  if (!x.sites()) {
    image_size("to_dense", x);
    return x;
  }
  const Tensor y = dense_copy(x, fill);
  if (!should_record({&x})) return y;
  return record("to_dense", y, {x}, [sites = x.sites()](const Tensor& dy, std::span<const char>) {
    return std::vector<Tensor>{sites_copy(dy, sites)};
  });
}

Tensor expand_to_sites(const Tensor& x, const std::shared_ptr<const ActiveSites>& sites) {
  if (x.dim() != 2 || x.size(0) != sites->n()) {
    fail("expand_to_sites", "input has shape {}, expected {} x K", to_string(x.shape()), sites->n());
  }
  const int64_t n = x.size(0), k = x.size(1);
  const auto compute = [sites, n, k](const Tensor& from) {
    Tensor to({sites->count(), k}, from.dtype());
    dispatch_floating("expand_to_sites", from.dtype(), [&]<class T>() {
      parallel_for(n, [&](int64_t image) {
        for (int64_t i = sites->first(image); i < sites->first(image + 1); ++i) {
          std::copy_n(from.data<T>() + image * k, k, to.data<T>() + i * k);
        }
      });
    });
    return to.set_sites(sites);
  };
  const Tensor y = compute(x);
  if (!should_record({&x})) return y;
  return record(
      "expand_to_sites", y, {x},
      [sites, n, k](const Tensor& dy, std::span<const char>) {
        Tensor dx({n, k}, dy.dtype());
        dispatch_floating("expand_to_sites", dy.dtype(), [&]<class T>() {
          parallel_for(n, [&](int64_t image) {
            std::vector<double> sums(static_cast<size_t>(k), 0.0);
            for (int64_t i = sites->first(image); i < sites->first(image + 1); ++i) {
              for (int64_t j = 0; j < k; ++j) {
                sums[static_cast<size_t>(j)] += static_cast<double>(dy.data<T>()[i * k + j]);
              }
            }
            for (int64_t j = 0; j < k; ++j) {
              dx.data<T>()[image * k + j] = static_cast<T>(sums[static_cast<size_t>(j)]);
            }
          });
        });
        return std::vector<Tensor>{dx};
      },
      [compute, kept = x.saved()] { return compute(kept.restored()); });
}

std::shared_ptr<const ActiveSites> support_of(const Tensor& mask, int64_t dilation) {
  const ImageSize size = image_size("support", mask);
  if (mask.sites() || size.channels != 1) {
    fail("support", "mask has shape {}, expected N x H x W x 1", to_string(mask.shape()));
  }
  std::vector<uint8_t> object(static_cast<size_t>(mask.numel()));
  dispatch_floating("support", mask.dtype(), [&]<class T>() {
    std::transform(mask.data<T>(), mask.data<T>() + mask.numel(), object.begin(),
                   [](T value) { return static_cast<uint8_t>(value != T{} ? 1 : 0); });
  });
  return support_of(size.n, size.h, size.w, object, dilation);
}

std::shared_ptr<const ActiveSites> common_sites(std::string_view operation, std::span<const Tensor> tensors) {
  const std::shared_ptr<const ActiveSites>& sites = tensors.front().sites();
  for (const Tensor& tensor : tensors.subspan(1)) {
    const std::shared_ptr<const ActiveSites>& other = tensor.sites();
    if (!sites != !other || (sites && !(*sites == *other))) {
      fail(operation, "inputs {} and {} have different active sites", to_string(tensors.front().shape()),
           to_string(tensor.shape()));
    }
  }
  return sites;
}

ImageSize image_size(std::string_view operation, const Tensor& x) {
  if (const auto& sites = x.sites()) return {sites->n(), sites->h(), sites->w(), x.size(1)};
  if (x.dim() != 4) fail(operation, "input has shape {}, expected N x H x W x C", to_string(x.shape()));
  return {x.size(0), x.size(1), x.size(2), x.size(3)};
}

}  // namespace opaline
