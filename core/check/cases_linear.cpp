// Matrix products.
#include <fmt/format.h>

#include <limits>

#include "core/check/op_case.h"
#include "core/check/reference.h"
#include "core/ops/attention.h"
#include "core/ops/linear.h"

namespace opaline::check {
namespace {

OpCase linear_case(const std::string& variant, const Shape& x, int64_t out, bool bias) {
  OpCase result{
      .name = "linear/" + variant,
      .inputs = {{.name = "x", .shape = x}, {.name = "weight", .shape = {out, x.back()}}},
      .forward =
          [](std::span<const Tensor> in) { return linear(in[0], in[1], in.size() > 2 ? in[2] : Tensor()); },
      .reference =
          [](std::span<const Array> in) {
            return reference::linear(in[0], in[1], in.size() > 2 ? std::optional(in[2]) : std::nullopt);
          }};
  if (bias) result.inputs.push_back({.name = "bias", .shape = {out}});
  return result;
}

struct Product {
  Shape batch;
  int64_t m, n, k;
};

OpCase matmul_case(const std::string& variant, const Product& p, bool ta, bool tb) {
  Shape a = p.batch, b = p.batch;
  a.insert(a.end(), {ta ? p.k : p.m, ta ? p.m : p.k});
  b.insert(b.end(), {tb ? p.n : p.k, tb ? p.k : p.n});
  return {
      .name = "matmul/" + variant,
      .inputs = {{.name = "a", .shape = a}, {.name = "b", .shape = b}},
      .forward =
          [ta, tb](std::span<const Tensor> in) {
            return matmul(in[0], in[1], {ta, tb});
          },
      .reference = [ta, tb](std::span<const Array> in) { return reference::matmul(in[0], in[1], ta, tb); },
      .options = {{"transpose_a", fmt::format("{}", ta)}, {"transpose_b", fmt::format("{}", tb)}}};
}

OpCase attention_case(const std::string& variant, const Shape& query, int64_t keys, int64_t heads,
                      Fill fill = fill::normal()) {
  const Shape other{query[0], keys, query[2]};
  return {.name = "scaled_dot_product_attention/" + variant,
          .inputs = {{.name = "query", .shape = query, .fill = fill},
                     {.name = "key", .shape = other, .fill = fill},
                     {.name = "value", .shape = other}},
          .forward =
              [heads](std::span<const Tensor> in) {
                return scaled_dot_product_attention(in[0], in[1], in[2], {.heads = heads});
              },
          .reference =
              [heads](std::span<const Array> in) { return reference::attention(in[0], in[1], in[2], heads); },
          .options = {{"heads", fmt::format("{}", heads)}}};
}

Fill with_nan_at(size_t position) {
  return [position](std::span<double> values, Random& random) {
    fill::normal()(values, random);
    values[position] = std::numeric_limits<double>::quiet_NaN();
  };
}

}  // namespace

std::vector<OpCase> linear_cases() {
  std::vector<OpCase> cases = {
      linear_case("plain", {5, 7}, 4, false),
      linear_case("bias", {4, 16}, 8, true),
      linear_case("tokens", {2, 5, 19}, 18, true),
      linear_case("vector", {9}, 5, true),
      linear_case("one_in", {6, 1}, 3, true),
      linear_case("one_out", {3, 11}, 1, true),
      linear_case("one_row", {1, 70}, 33, true),
      linear_case("no_rows", {0, 4}, 3, true),
      matmul_case("nn", {{2, 3}, 4, 5, 6}, false, false),
      matmul_case("nt", {{2, 3}, 4, 5, 6}, false, true),
      matmul_case("tn", {{2, 3}, 4, 5, 6}, true, false),
      matmul_case("tt", {{2, 3}, 4, 5, 6}, true, true),
      matmul_case("nn_2d", {{}, 7, 17, 33}, false, false),
      matmul_case("nt_2d", {{}, 17, 9, 20}, false, true),
      matmul_case("tn_2d", {{}, 16, 16, 3}, true, false),
      matmul_case("tt_2d", {{}, 5, 18, 9}, true, true),
      matmul_case("outer", {{4}, 6, 7, 1}, false, false),
      matmul_case("inner", {{3}, 1, 1, 23}, false, true),
      matmul_case("no_batch", {{0}, 2, 3, 4}, false, false),
      attention_case("self", {2, 5, 6}, 5, 2),
      attention_case("cross", {1, 3, 16}, 7, 1),
      attention_case("one_key", {1, 4, 6}, 1, 3),
      attention_case("lanes", {1, 17, 32}, 18, 2),
      attention_case("blocks", {1, 130, 4}, 9, 2),
      attention_case("sharp", {1, 5, 8}, 6, 2, fill::normal(6.0)),
      attention_case("no_batch", {0, 3, 4}, 3, 2),
  };
  for (OpCase nan : {linear_case("nan", {4, 9}, 6, true), matmul_case("nan", {{2}, 3, 4, 5}, false, true),
                     attention_case("nan", {1, 4, 6}, 5, 2)}) {
    nan.inputs[0].fill = with_nan_at(12);
    nan.smooth = false;
    cases.push_back(std::move(nan));
  }
  return cases;
}

std::vector<OpCase> large_linear_cases(int64_t side) {
  const int64_t tokens = side;  // (side / 16)^2 of them at side 256
  return {
      linear_case("512_2048", {tokens, 512}, 2048, true),
      linear_case("head", {8, 512 * side}, 27, true),
      attention_case("tokens_512", {2, tokens, 512}, tokens, 8),
      matmul_case("attention_scores", {{8}, tokens, tokens, 64}, false, true),
      matmul_case("attention_values", {{8}, tokens, 64, tokens}, false, false),
  };
}

}  // namespace opaline::check
