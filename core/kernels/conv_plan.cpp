#include "core/kernels/conv_plan.h"

#include <algorithm>
#include <array>
#include <cstdio>
#include <nlohmann/json.hpp>

#include "core/error.h"

namespace opaline::kernels {
namespace {

constexpr std::array kPasses{ConvPass::kForward, ConvPass::kInputGradient, ConvPass::kWeightGradient};

double share(const ConvShape& s) {
  return static_cast<double>(s.sixteenths) / 16.0;
}

/// Work of a pass in multiply-adds at the full rate of the machine. Its terms, from measurements of layers of
/// 16 to 512 channels and 6 to 256 pixels a side: the products; what a filter costs, whatever the image's
/// size (it is fetched, turned, transformed, written and read again; the sums for its gradient likewise);
/// what a tile costs (it is transformed on the way in and out).
double direct_work(const ConvShape& s, ConvPass pass) {
  const bool weights = pass == ConvPass::kWeightGradient;
  const double products = share(s) * static_cast<double>(s.n * s.out_h() * s.out_w()) *
                          static_cast<double>(s.kernel_h * s.kernel_w);
  const double filter = weights ? 4500.0 : 1700.0;
  return static_cast<double>(s.in * s.out) * (products / (weights ? 0.7 : 0.88) + filter);
}

double winograd_work(const ConvShape& s, ConvPass pass, int outputs) {
  constexpr double kFetch = 500.0, kFilter = 15.0, kFilterNear = 6.0;
  constexpr double kFetchSum = 600.0, kSum = 80.0, kSumNear = 16.0, kTile = 26.0;
  // Where filters and sums stay near the core: winograd.cpp, winograd_weight.cpp.
  constexpr double kFewTiles = 128.0, kFewSumTiles = 256.0;
  constexpr int64_t kVector = 16, kManyOutputs = 256;
  const bool backward = pass == ConvPass::kInputGradient;
  const int64_t border = backward && s.reflect ? s.padding : 0;
  const int64_t rows = backward ? s.h + 2 * border : s.out_h(),
                columns = backward ? s.w + 2 * border : s.out_w();
  const auto down = static_cast<double>((rows + outputs - 1) / outputs);
  const auto across = static_cast<double>((columns + outputs - 1) / outputs);
  const double tiles = share(s) * static_cast<double>(s.n) * down * across;
  const int64_t taps = outputs == 3 ? 4 : 3, side = outputs + taps - 1;
  const int64_t blocks = (s.kernel_h + taps - 1) / taps * ((s.kernel_w + taps - 1) / taps);
  const int64_t from = backward ? s.out : s.in, to = backward ? s.in : s.out;
  const int64_t sums = blocks == 1 ? from : blocks * ((from + kVector - 1) / kVector * kVector);
  const auto filters = static_cast<double>(sums * to), channels = static_cast<double>(sums + to);
  const auto frequencies = static_cast<double>(side * side);
  const double fetched =
      kFetch + (tiles < kFewTiles && to >= kManyOutputs ? kFilterNear : kFilter) * frequencies;
  const double summed = tiles <= kFewSumTiles ? kFetchSum + kSumNear * frequencies : kSum * frequencies;
  const double each = pass == ConvPass::kWeightGradient ? summed : fetched;
  // Larger tiles go through more registers than there are, and save little: they should be worth their error.
  const double transform = kTile * (outputs == 6 ? 2.4 : 1.0);
  return filters * (frequencies * tiles / 0.88 + each) + frequencies * tiles * channels * transform;
}

}  // namespace

int choose_algorithm(const ConvShape& s, ConvPass pass, Numerics numerics) {
  if (s.n == 0) return 0;
  // The tiles' gradients of weights cancel too much for strict: up to 1e-6 on real activations.
  const int strictest = pass == ConvPass::kWeightGradient ? 0 : 2;
  const int largest = numerics == Numerics::kFast ? 6 : numerics == Numerics::kBalanced ? 4 : strictest;
  // What saves a few microseconds is not worth a larger error.
  constexpr double kWorthwhile = 2e6;
  int best = 0;
  double least = direct_work(s, pass) - kWorthwhile;
  for (int outputs = 2; outputs <= largest; ++outputs) {
    if (!winograd_fits(s, outputs)) continue;
    const double work = winograd_work(s, pass, outputs);
    if (work < least) {
      least = work;
      best = outputs;
    }
  }
  return best;
}

int ConvPlan::outputs(const ConvShape& s, ConvPass pass) {
  const std::lock_guard lock(mutex_);
  const auto [entry, fresh] = choices_.try_emplace({s, pass}, 0);
  if (fresh) entry->second = choose_algorithm(s, pass, numerics_);
  return entry->second;
}

std::string ConvPlan::to_json() const {
  const std::lock_guard lock(mutex_);
  nlohmann::ordered_json convolutions = nlohmann::ordered_json::object();
  for (const auto& [key, outputs] : choices_) {
    convolutions[to_string(key.first)][std::string(to_string(key.second))] = outputs;
  }
  const nlohmann::ordered_json json = {{"numerics", to_string(numerics_)}, {"convolutions", convolutions}};
  return json.dump(1) + "\n";
}

Numerics planned_numerics(std::string_view json, std::string_view source) {
  try {
    const std::string name = nlohmann::json::parse(json).at("numerics");
    if (const auto numerics = parse_numerics(name)) return *numerics;
    fail(source, "has numerics \"{}\"", name);
  } catch (const nlohmann::json::exception& error) {
    fail(source, "is no plan of convolutions: {}", error.what());
  }
}

void ConvPlan::load(std::string_view json, std::string_view source) {
  try {
    if (const Numerics made_for = planned_numerics(json, source); made_for != numerics_) {
      fail(source, "was made for {} numerics, not {}", to_string(made_for), to_string(numerics_));
    }
    const auto parsed = nlohmann::json::parse(json);
    std::map<Key, int> choices;
    for (const auto& [shape, passes] : parsed.at("convolutions").items()) {
      const ConvShape s = parse_conv_shape(shape);
      for (const auto& [name, value] : passes.items()) {
        const auto pass = std::find_if(kPasses.begin(), kPasses.end(),
                                       [&](ConvPass candidate) { return to_string(candidate) == name; });
        const int outputs = value.get<int>();
        if (pass == kPasses.end() || (outputs != 0 && !winograd_fits(s, outputs))) {
          fail(source, "\"{}\" has pass \"{}\" with tiles of {}", shape, name, outputs);
        }
        choices[{s, *pass}] = outputs;
      }
    }
    const std::lock_guard lock(mutex_);
    choices_ = std::move(choices);
  } catch (const nlohmann::json::exception& error) {
    fail(source, "is no plan of convolutions: {}", error.what());
  }
}

std::string to_string(const ConvShape& s) {
  return fmt::format("{}x{}x{}x{} -> {}, kernel {}x{}, stride {}, padding {}{}{}", s.n, s.h, s.w, s.in, s.out,
                     s.kernel_h, s.kernel_w, s.stride, s.padding, s.reflect ? " mirrored" : "",
                     s.sixteenths == 16 ? "" : fmt::format(", {}/16 of the pixels", s.sixteenths));
}

ConvShape parse_conv_shape(std::string_view text) {
  ConvShape s;
  const std::string line(text);
  int end = 0;
  long long v[9] = {};
  const int read =
      std::sscanf(line.c_str(), "%lldx%lldx%lldx%lld -> %lld, kernel %lldx%lld, stride %lld, padding %lld%n",
                  &v[0], &v[1], &v[2], &v[3], &v[4], &v[5], &v[6], &v[7], &v[8], &end);
  std::string_view rest = read == 9 ? std::string_view(line).substr(static_cast<size_t>(end)) : "?";
  long long parts = 16, of = 16;
  if (const size_t comma = rest.find(", "); comma != std::string_view::npos) {
    const std::string share(rest.substr(comma));
    end = -1;
    std::sscanf(share.c_str(), ", %lld/%lld of the pixels%n", &parts, &of, &end);
    const bool sound =
        end == static_cast<int>(share.size()) && (of == 16 || of == 8) && parts >= 0 && parts < of;
    rest = sound ? rest.substr(0, comma) : "?";
  }
  if (read != 9 || (!rest.empty() && rest != " mirrored") ||
      std::any_of(std::begin(v), std::end(v),
                  [](long long value) { return value < 0 || value > (1LL << 40); })) {
    fail("convolution", "\"{}\" is no shape of one", text);
  }
  s = {.n = v[0],
       .h = v[1],
       .w = v[2],
       .in = v[3],
       .out = v[4],
       .kernel_h = v[5],
       .kernel_w = v[6],
       .stride = v[7],
       .padding = v[8],
       .reflect = !rest.empty(),
       .sixteenths = parts * 16 / of};
  return s;
}

std::string_view to_string(ConvPass pass) {
  switch (pass) {
    case ConvPass::kForward:
      return "forward";
    case ConvPass::kInputGradient:
      return "input gradient";
    case ConvPass::kWeightGradient:
      return "weight gradient";
  }
  return "";
}

}  // namespace opaline::kernels
