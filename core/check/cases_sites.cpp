// Operations on active sites: whole images go in, the operation sees some of their pixels alone, and the
// result comes back with zeros between. The references are those of whole images whose absent pixels are
// zeros (minus infinity, where a maximum is taken), or of one image after the other without them.
#include <algorithm>
#include <limits>

#include "core/check/op_case.h"
#include "core/check/reference.h"
#include "core/ops/activation.h"
#include "core/ops/arithmetic.h"
#include "core/ops/attention.h"
#include "core/ops/conv.h"
#include "core/ops/loss.h"
#include "core/ops/norm.h"
#include "core/ops/pool.h"
#include "core/ops/resize.h"
#include "core/ops/shape.h"
#include "core/ops/sites.h"

namespace opaline::check {
namespace {

using Sites = std::shared_ptr<const ActiveSites>;

/// A mask by its name: "full"; "holes", two pixels of three; "islands", blocks apart from each other, at
/// corners and edges too; "pixel", one in the first image and none in the others; "frame", the border alone;
/// "empty".
Sites make_sites(const std::string& pattern, int64_t n, int64_t h, int64_t w) {
  std::vector<uint8_t> active(static_cast<size_t>(n * h * w));
  for (int64_t i = 0; i < n * h * w; ++i) {
    const int64_t image = i / (h * w), row = i / w % h, column = i % w;
    bool on = pattern == "full";
    if (pattern == "holes") on = (row * 5 + column * 3 + row * column + image) % 3 != 0;
    if (pattern == "islands") on = (row / 2 + image) % 2 == 0 && column / 3 % 2 == 0;
    if (pattern == "pixel") on = image == 0 && row == 0 && column == w / 2;
    if (pattern == "frame") on = row == 0 || column == 0 || row == h - 1 || column == w - 1;
    active[static_cast<size_t>(i)] = on ? 1 : 0;
  }
  return std::make_shared<const ActiveSites>(n, h, w, active);
}

constexpr std::string_view kPatterns[] = {"full", "holes", "islands", "pixel", "frame", "empty"};

/// N x H x W x C with `value` where pixels are absent.
Array without_absent(Array x, const ActiveSites& sites, double value = 0.0) {
  for (int64_t i = 0; i < x.count(); ++i) {
    const int64_t pixel = i / x.last();
    if (sites.site(pixel / (sites.h() * sites.w()), pixel / sites.w() % sites.h(), pixel % sites.w()) < 0) {
      x[i] = value;
    }
  }
  return x;
}

/// Sites of the images [first, last) as one row of pixels, 1 x 1 x sites x C, and back.
Array sites_of(const Array& x, const ActiveSites& sites, int64_t first, int64_t last) {
  Array row(Shape{1, 1, sites.first(last) - sites.first(first), x.last()});
  for (int64_t i = first * sites.h() * sites.w(); i < last * sites.h() * sites.w(); ++i) {
    const int64_t site = sites.site(i / (sites.h() * sites.w()), i / sites.w() % sites.h(), i % sites.w());
    for (int64_t c = 0; site >= 0 && c < x.last(); ++c) {
      row[(site - sites.first(first)) * x.last() + c] = x[i * x.last() + c];
    }
  }
  return row;
}
void put_back(const Array& row, const ActiveSites& sites, int64_t first, int64_t last, Array& x) {
  for (int64_t i = first * sites.h() * sites.w(); i < last * sites.h() * sites.w(); ++i) {
    const int64_t site = sites.site(i / (sites.h() * sites.w()), i / sites.w() % sites.h(), i % sites.w());
    for (int64_t c = 0; site >= 0 && c < x.last(); ++c) {
      x[i * x.last() + c] = row[(site - sites.first(first)) * x.last() + c];
    }
  }
}

/// f of the sites of each image that has any, as 1 x 1 x sites x C.
template <class F>
Array each_image(const Array& x, const ActiveSites& sites, const F& f) {
  Array y(x.shape);
  for (int64_t image = 0; image < sites.n(); ++image) {
    if (sites.first(image) == sites.first(image + 1)) continue;
    put_back(f(image), sites, image, image + 1, y);
  }
  return y;
}

std::string named(std::string_view operation, std::string_view pattern, std::string_view variant) {
  return fmt::format("{}/sites_{}{}{}", operation, pattern, variant.empty() ? "" : "_", variant);
}

OpCase of_sites(OpCase op_case) {
  op_case.in_pytorch = false;
  return op_case;
}

OpCase conv_case(std::string_view pattern, std::string_view variant, const Shape& x, int64_t out,
                 int64_t kernel, const Conv2dOptions& o) {
  const Sites sites = make_sites(std::string(pattern), x[0], x[1], x[2]);
  const Sites result = o.stride == 2 ? sites->halved() : sites;
  return of_sites({.name = named("conv2d", pattern, variant),
                   .inputs = {{.name = "x", .shape = x},
                              {.name = "weight", .shape = {out, x[3], kernel, kernel}},
                              {.name = "bias", .shape = {out}}},
                   .forward =
                       [sites, o](std::span<const Tensor> in) {
                         return to_dense(conv2d(select_sites(in[0], sites), in[1], in[2], o));
                       },
                   .reference =
                       [sites, result, o](std::span<const Array> in) {
                         return without_absent(
                             reference::conv2d(without_absent(in[0], *sites), in[1], in[2],
                                               {.stride = o.stride,
                                                .padding = o.padding,
                                                .reflect = o.padding_mode == Padding::kReflect}),
                             *result);
                       },
                   .options = {{"stride", std::to_string(o.stride)},
                               {"padding", std::to_string(o.padding)},
                               {"reflect", o.padding_mode == Padding::kReflect ? "true" : "false"}}});
}

/// Two images next to each other, the first of whole vectors of channels.
OpCase parts_case(std::string_view pattern) {
  const Shape x{2, 6, 8, 16}, z{2, 6, 8, 5};
  const Sites sites = make_sites(std::string(pattern), x[0], x[1], x[2]);
  return of_sites({.name = named("conv2d", pattern, "parts"),
                   .inputs = {{.name = "x", .shape = x},
                              {.name = "z", .shape = z},
                              {.name = "weight", .shape = {7, 21, 3, 3}},
                              {.name = "bias", .shape = {7}}},
                   .forward =
                       [sites](std::span<const Tensor> in) {
                         const Tensor parts[] = {select_sites(in[0], sites), select_sites(in[1], sites)};
                         return to_dense(conv2d(parts, in[2], in[3], {.padding = 1}));
                       },
                   .reference =
                       [sites](std::span<const Array> in) {
                         const Array joined = reference::concat(in.first(2), 3);
                         return without_absent(
                             reference::conv2d(without_absent(joined, *sites), in[2], in[3], {.padding = 1}),
                             *sites);
                       },
                   .options = {{"stride", "1"}, {"padding", "1"}, {"reflect", "false"}}});
}

OpCase batch_norm_case(std::string_view pattern) {
  const Shape x{2, 6, 8, 5}, channels{5};
  const Sites sites = make_sites(std::string(pattern), x[0], x[1], x[2]);
  return of_sites(
      {.name = named("batch_norm", pattern, ""),
       .inputs = {{.name = "x", .shape = x},
                  {.name = "weight", .shape = channels},
                  {.name = "bias", .shape = channels},
                  {.name = "running_mean", .shape = channels, .differentiable = false, .updated = true},
                  {.name = "running_var",
                   .shape = channels,
                   .fill = fill::uniform(0.5, 2.0),
                   .differentiable = false,
                   .updated = true}},
       .forward =
           [sites](std::span<const Tensor> in) {
             return to_dense(batch_norm(select_sites(in[0], sites), in[1], in[2], in[3], in[4], {}));
           },
       .reference = [sites](std::span<const Array> in) -> ReferenceResult {
         if (sites->count() == 0) return {Array(in[0].shape), {in[3], in[4]}};
         auto r = reference::batch_norm(sites_of(in[0], *sites, 0, sites->n()), in[1], in[2], in[3], in[4],
                                        true, 0.1, 1e-5);
         Array y(in[0].shape);
         put_back(r.y, *sites, 0, sites->n(), y);
         return {std::move(y), {std::move(r.running_mean), std::move(r.running_var)}};
       }});
}

OpCase instance_norm_case(std::string_view pattern) {
  const Shape x{3, 4, 6, 5};
  const Sites sites = make_sites(std::string(pattern), x[0], x[1], x[2]);
  return of_sites({.name = named("instance_norm", pattern, ""),
                   .inputs = {{.name = "x", .shape = x}},
                   .forward =
                       [sites](std::span<const Tensor> in) {
                         return to_dense(instance_norm(select_sites(in[0], sites)));
                       },
                   .reference =
                       [sites](std::span<const Array> in) {
                         return each_image(in[0], *sites, [&](int64_t image) {
                           return reference::instance_norm(sites_of(in[0], *sites, image, image + 1),
                                                           std::nullopt, std::nullopt, 1e-5);
                         });
                       }});
}

OpCase max_pool_case(std::string_view pattern) {
  const Shape x{2, 6, 8, 5};
  const Sites sites = make_sites(std::string(pattern), x[0], x[1], x[2]);
  return of_sites({.name = named("max_pool2d", pattern, ""),
                   .inputs = {{.name = "x", .shape = x, .fill = fill::distinct()}},
                   .forward =
                       [sites](std::span<const Tensor> in) {
                         return to_dense(max_pool2d(select_sites(in[0], sites), 2));
                       },
                   .reference =
                       [sites](std::span<const Array> in) {
                         constexpr double kInfinity = std::numeric_limits<double>::infinity();
                         return without_absent(
                             reference::max_pool2d(without_absent(in[0], *sites, -kInfinity), 2),
                             *sites->halved());
                       }});
}

OpCase upsample_case(std::string_view pattern, bool align) {
  const Sites fine = make_sites(std::string(pattern), 2, 6, 8), coarse = fine->halved();
  const UpsampleOptions o{.height = 6, .width = 8, .align_corners = align, .sites = fine};
  return of_sites({.name = named("upsample_bilinear", pattern, align ? "aligned" : "half_pixel"),
                   .inputs = {{.name = "x", .shape = {2, 3, 4, 5}}},
                   .forward =
                       [coarse, o](std::span<const Tensor> in) {
                         return to_dense(upsample_bilinear(select_sites(in[0], coarse), o));
                       },
                   .reference =
                       [fine, coarse, align](std::span<const Array> in) {
                         return without_absent(
                             reference::upsample_bilinear(without_absent(in[0], *coarse), 6, 8, align),
                             *fine);
                       }});
}

OpCase nearest_case() {
  const Sites fine = make_sites("holes", 2, 6, 8), coarse = fine->halved();
  const UpsampleOptions o{.height = 6, .width = 8, .sites = fine};
  return of_sites({.name = named("upsample_nearest", "holes", ""),
                   .inputs = {{.name = "x", .shape = {2, 3, 4, 5}}},
                   .forward =
                       [coarse, o](std::span<const Tensor> in) {
                         return to_dense(upsample_nearest(select_sites(in[0], coarse), o));
                       },
                   .reference =
                       [fine, coarse](std::span<const Array> in) {
                         return without_absent(
                             reference::upsample_nearest(without_absent(in[0], *coarse), 6, 8), *fine);
                       }});
}

OpCase attention_case(std::string_view pattern) {
  const Shape x{2, 4, 6, 8};
  const Sites sites = make_sites(std::string(pattern), x[0], x[1], x[2]);
  return of_sites(
      {.name = named("scaled_dot_product_attention", pattern, ""),
       .inputs = {{.name = "query", .shape = x}, {.name = "key", .shape = x}, {.name = "value", .shape = x}},
       .forward =
           [sites](std::span<const Tensor> in) {
             return to_dense(scaled_dot_product_attention(select_sites(in[0], sites),
                                                          select_sites(in[1], sites),
                                                          select_sites(in[2], sites), {.heads = 2}));
           },
       .reference =
           [sites](std::span<const Array> in) {
             return each_image(in[0], *sites, [&](int64_t image) {
               const auto tokens = [&](const Array& a) {
                 Array row = sites_of(a, *sites, image, image + 1);
                 row.shape = {1, row.size(2), row.size(3)};
                 return row;
               };
               return reference::attention(tokens(in[0]), tokens(in[1]), tokens(in[2]), 2);
             });
           }});
}

template <class F, class R>
OpCase loss_case(std::string_view operation, std::string_view pattern, const F& loss, const R& reference) {
  const Shape x{2, 4, 6, 3};
  const Sites sites = make_sites(std::string(pattern), x[0], x[1], x[2]);
  return of_sites(
      {.name = named(operation, pattern, ""),
       .inputs = {{.name = "x", .shape = x},
                  {.name = "target", .shape = x, .differentiable = false},
                  {.name = "mask", .shape = {2, 4, 6, 1}, .fill = fill::mask(), .differentiable = false}},
       .forward =
           [sites, loss](std::span<const Tensor> in) {
             return loss(select_sites(in[0], sites), select_sites(in[1], sites), select_sites(in[2], sites));
           },
       .reference =
           [sites, reference](std::span<const Array> in) {
             return reference(in[0], in[1], without_absent(in[2], *sites));
           }});
}

OpCase select_case(std::string_view pattern) {
  const Sites sites = make_sites(std::string(pattern), 2, 4, 6);
  return of_sites({.name = named("select_sites", pattern, ""),
                   .inputs = {{.name = "x", .shape = {2, 4, 6, 3}}},
                   .forward = [sites](std::span<const Tensor> in) { return select_sites(in[0], sites); },
                   .reference =
                       [sites](std::span<const Array> in) {
                         Array y = sites_of(in[0], *sites, 0, sites->n());
                         y.shape = {y.size(2), y.size(3)};
                         return y;
                       }});
}

OpCase dense_case(std::string_view pattern) {
  const Sites sites = make_sites(std::string(pattern), 2, 4, 6);
  return of_sites({.name = named("to_dense", pattern, ""),
                   .inputs = {{.name = "x", .shape = {sites->count(), 3}}},
                   .forward =
                       [sites](std::span<const Tensor> in) {
                         // As a part of something larger: sites are a tensor's own, not a leaf's.
                         Tensor x = affine(in[0], 1.0);
                         return to_dense(x.set_sites(sites), 2.0);
                       },
                   .reference =
                       [sites](std::span<const Array> in) {
                         Array y(Shape{2, 4, 6, 3});
                         std::fill(y.values.begin(), y.values.end(), 2.0);
                         put_back(in[0], *sites, 0, sites->n(), y);
                         return y;
                       }});
}

OpCase expand_case(std::string_view pattern) {
  const Sites sites = make_sites(std::string(pattern), 2, 4, 6);
  return of_sites(
      {.name = named("expand_to_sites", pattern, ""),
       .inputs = {{.name = "x", .shape = {2, 3}}},
       .forward = [sites](std::span<const Tensor> in) { return to_dense(expand_to_sites(in[0], sites)); },
       .reference =
           [sites](std::span<const Array> in) {
             Array y(Shape{2, 4, 6, 3});
             for (int64_t i = 0; i < y.count(); ++i) y[i] = in[0][i / 72 * 3 + i % 3];
             return without_absent(std::move(y), *sites);
           }});
}

/// What hands sites on without looking at them.
OpCase chain_case() {
  const Sites sites = make_sites("holes", 2, 4, 6);
  return of_sites({.name = "concat/sites_holes_chain",
                   .inputs = {{.name = "x", .shape = {2, 4, 6, 3}}, {.name = "z", .shape = {2, 4, 6, 2}}},
                   .forward =
                       [sites](std::span<const Tensor> in) {
                         const Tensor x = gelu(select_sites(in[0], sites)), z = select_sites(in[1], sites);
                         return to_dense(concat({add(x, x), z}));
                       },
                   .reference =
                       [sites](std::span<const Array> in) {
                         const Array parts[] = {
                             reference::map(in[0], [](double v) { return 2.0 * reference::gelu(v); }), in[1]};
                         return without_absent(reference::concat(parts, 3), *sites);
                       }});
}

}  // namespace

std::vector<OpCase> sites_cases() {
  std::vector<OpCase> cases;
  for (const std::string_view pattern : kPatterns) {
    cases.push_back(conv_case(pattern, "", {2, 6, 8, 5}, 6, 3, {.padding = 1}));
    cases.push_back(conv_case(pattern, "lanes", {2, 8, 10, 16}, 32, 3, {.padding = 1}));
    cases.push_back(conv_case(pattern, "halving", {2, 6, 8, 5}, 6, 3, {.stride = 2, .padding = 1}));
    cases.push_back(conv_case(pattern, "mirrored", {2, 6, 8, 4}, 3, 3,
                              {.padding = 1, .padding_mode = Padding::kReflect}));
    cases.push_back(conv_case(pattern, "mirrored_7", {1, 8, 10, 3}, 2, 7,
                              {.padding = 3, .padding_mode = Padding::kReflect}));
    cases.push_back(conv_case(pattern, "pointwise", {2, 4, 6, 5}, 3, 1, {}));
    cases.push_back(parts_case(pattern));
    cases.push_back(batch_norm_case(pattern));
    cases.push_back(instance_norm_case(pattern));
    cases.push_back(max_pool_case(pattern));
    cases.push_back(upsample_case(pattern, true));
    cases.push_back(upsample_case(pattern, false));
    cases.push_back(attention_case(pattern));
    cases.push_back(loss_case("masked_l1_loss", pattern, masked_l1_loss, reference::masked_l1_loss));
    cases.push_back(loss_case("masked_mse_loss", pattern, masked_mse_loss, reference::masked_mse_loss));
    cases.push_back(loss_case("cosine_loss", pattern, cosine_loss, reference::cosine_loss));
    cases.push_back(select_case(pattern));
    cases.push_back(dense_case(pattern));
    cases.push_back(expand_case(pattern));
  }
  // So tall that some of its rows are far from the border, and all of the result's pixels exist.
  cases.push_back(conv_case("holes", "halving_tall", {1, 300, 8, 2}, 3, 3, {.stride = 2, .padding = 1}));
  cases.push_back(nearest_case());
  cases.push_back(chain_case());
  return cases;
}

}  // namespace opaline::check
