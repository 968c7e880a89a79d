// bench_onednn: single convolutions beside oneDNN (Debian's libdnnl-dev), taking turns, with both errors.
#include <CLI/CLI.hpp>
#include <cmath>
#include <cstdio>
#include <functional>
#include <map>
#include <oneapi/dnnl/dnnl.hpp>
#include <optional>
#include <string>
#include <vector>

#include "core/check/machine.h"
#include "core/clock.h"
#include "core/file.h"
#include "core/instruction_set.h"
#include "core/kernels/direct.h"
#include "core/kernels/winograd.h"
#include "core/parallel.h"
#include "core/random.h"
#include "core/tensor.h"
#include "data/chart.h"

namespace opaline::bench {
namespace {

using dnnl::memory;
using kernels::ConvPass;
using kernels::ConvShape;

struct Layer {
  ConvShape shape;
  Tensor x, weight, dy;             // float32; N x H x W x C and O x I x KH x KW
  Tensor y_wide, dx_wide, dw_wide;  // what they should give
};

Tensor random_normal(Shape shape, uint32_t sample, double deviation) {
  Tensor tensor(std::move(shape));
  Random random(1, Purpose::kTest, 0, sample);
  for (float& value : tensor.values<float>()) value = static_cast<float>(deviation * random.normal());
  return tensor;
}

Layer make_layer(int64_t batch, int64_t size, int64_t in, int64_t out) {
  Layer layer;
  ConvShape& s = layer.shape = {.n = batch,
                                .h = size,
                                .w = size,
                                .in = in,
                                .out = out,
                                .kernel_h = 3,
                                .kernel_w = 3,
                                .stride = 1,
                                .padding = 1};
  layer.x = random_normal({s.n, s.h, s.w, s.in}, 0, 1.0);
  for (float& value : layer.x.values<float>()) value = std::max(value, 0.0F);  // as after a rectifier
  layer.weight = random_normal({s.out, s.in, 3, 3}, 1, 0.02);
  layer.dy = random_normal({s.n, s.h, s.w, s.out}, 2, 1.0);
  const Tensor x = layer.x.to(DType::kFloat64), w = layer.weight.to(DType::kFloat64),
               dy = layer.dy.to(DType::kFloat64);
  layer.y_wide = Tensor({s.n, s.h, s.w, s.out}, DType::kFloat64);
  layer.dx_wide = Tensor({s.n, s.h, s.w, s.in}, DType::kFloat64);
  layer.dw_wide = Tensor(layer.weight.shape(), DType::kFloat64);
  kernels::direct_forward<double>(s, x.data<double>(), w.data<double>(), nullptr,
                                  layer.y_wide.data<double>());
  kernels::direct_input_gradient<double>(s, dy.data<double>(), w.data<double>(), nullptr,
                                         layer.dx_wide.data<double>());
  kernels::direct_weight_gradient<double>(s, x.data<double>(), dy.data<double>(),
                                          layer.dw_wide.data<double>());
  return layer;
}

/// Root mean square of the difference over that of the reference.
double error(const Tensor& value, const Tensor& reference) {
  double difference = 0.0, size = 0.0;
  for (int64_t i = 0; i < value.numel(); ++i) {
    difference += std::pow(static_cast<double>(value.data<float>()[i]) - reference.data<double>()[i], 2);
    size += std::pow(reference.data<double>()[i], 2);
  }
  return std::sqrt(difference / size);
}

/// One way to do a pass: a run writes `result`, in our layout, after finish().
struct Contender {
  std::string name;
  std::function<void()> run;
  std::function<void()> finish = [] {};
  Tensor result = {};
};

Contender ours(const Layer& layer, ConvPass pass, int outputs) {
  const ConvShape& s = layer.shape;
  Contender c{.name = outputs == 0 ? "opaline direct" : fmt::format("opaline F({0}x{0})", outputs),
              .run = {}};
  c.result = Tensor((pass == ConvPass::kForward         ? layer.y_wide
                     : pass == ConvPass::kInputGradient ? layer.dx_wide
                                                        : layer.dw_wide)
                        .shape());
  c.run = [&layer, &s, pass, outputs, result = c.result]() mutable {
    const float* const x = layer.x.data<float>();
    const float* const w = layer.weight.data<float>();
    const float* const dy = layer.dy.data<float>();
    float* const to = result.data<float>();
    const kernels::Part<const float> in{x, s.in};
    const kernels::Part<float> gradient{to, s.in};
    switch (pass) {
      case ConvPass::kForward:
        if (outputs == 0) return kernels::direct_forward<float>(s, x, w, nullptr, to);
        return kernels::winograd_forward<float>(outputs, s, {&in, 1}, w, nullptr, to);
      case ConvPass::kInputGradient:
        if (outputs == 0) return kernels::direct_input_gradient<float>(s, dy, w, nullptr, to);
        return kernels::winograd_input_gradient<float>(outputs, s, dy, w, nullptr, {&gradient, 1});
      case ConvPass::kWeightGradient:
        if (outputs == 0) return kernels::direct_weight_gradient<float>(s, x, dy, to);
        return kernels::winograd_weight_gradient<float>(outputs, s, {&in, 1}, dy, to);
    }
  };
  return c;
}

/// oneDNN in the layouts that it likes best; moving data there is not timed. Nothing where it lacks the pass.
std::optional<Contender> theirs(const Layer& layer, ConvPass pass, bool winograd) {
  const ConvShape& s = layer.shape;
  static const dnnl::engine engine(dnnl::engine::kind::cpu, 0);
  dnnl::stream stream(engine);
  using Tag = memory::format_tag;
  const auto any = [](const memory::dims& dims) {
    return memory::desc(dims, memory::data_type::f32, Tag::any);
  };
  const memory::dims x_dims{s.n, s.in, s.h, s.w}, w_dims{s.out, s.in, 3, 3}, y_dims{s.n, s.out, s.h, s.w};
  const memory::dims one{1, 1};
  const auto algorithm =
      winograd ? dnnl::algorithm::convolution_winograd : dnnl::algorithm::convolution_direct;
  try {
    const dnnl::convolution_forward::primitive_desc forward(
        {dnnl::prop_kind::forward_training, algorithm, any(x_dims), any(w_dims), any(y_dims), one, one, one},
        engine);
    const auto plain = [&](const memory::dims& dims, Tag tag, const Tensor& tensor) {
      return memory({dims, memory::data_type::f32, tag}, engine,
                    const_cast<std::byte*>(tensor.bytes()));  // the library's memory is never const
    };
    const auto moved = [&](const memory& from, const memory::desc& desc) {
      memory to(desc, engine);
      dnnl::reorder(from, to).execute(stream, const_cast<memory&>(from), to);
      stream.wait();
      return to;
    };
    const memory x = plain(x_dims, Tag::nhwc, layer.x), w = plain(w_dims, Tag::oihw, layer.weight),
                 dy = plain(y_dims, Tag::nhwc, layer.dy);
    Contender c{.name = winograd ? "oneDNN Winograd" : "oneDNN direct", .run = {}};
    const auto prepare = [&](const auto& primitive, const std::unordered_map<int, memory>& arguments,
                             const memory& to, const memory::dims& dims, Tag tag, const Tensor& like) {
      c.result = Tensor(like.shape());
      c.run = [primitive, stream, arguments] {
        dnnl::stream s_run = stream;
        primitive.execute(s_run, arguments);
        s_run.wait();
      };
      c.finish = [to, result = plain(dims, tag, c.result), stream] {
        dnnl::stream s_run = stream;
        memory from = to, target = result;
        dnnl::reorder(from, target).execute(s_run, from, target);
        s_run.wait();
      };
    };
    if (pass == ConvPass::kForward) {
      memory y(forward.dst_desc(), engine);
      prepare(dnnl::convolution_forward(forward),
              {{DNNL_ARG_SRC, moved(x, forward.src_desc())},
               {DNNL_ARG_WEIGHTS, moved(w, forward.weights_desc())},
               {DNNL_ARG_DST, y}},
              y, y_dims, Tag::nhwc, layer.y_wide);
    } else if (pass == ConvPass::kInputGradient) {
      const dnnl::convolution_backward_data::primitive_desc desc(
          {algorithm, any(x_dims), any(w_dims), any(y_dims), one, one, one}, engine, forward);
      memory dx(desc.diff_src_desc(), engine);
      prepare(dnnl::convolution_backward_data(desc),
              {{DNNL_ARG_DIFF_DST, moved(dy, desc.diff_dst_desc())},
               {DNNL_ARG_WEIGHTS, moved(w, desc.weights_desc())},
               {DNNL_ARG_DIFF_SRC, dx}},
              dx, x_dims, Tag::nhwc, layer.dx_wide);
    } else {
      const dnnl::convolution_backward_weights::primitive_desc desc(
          {algorithm, any(x_dims), any(w_dims), any(y_dims), one, one, one}, engine, forward);
      memory dw(desc.diff_weights_desc(), engine);
      prepare(dnnl::convolution_backward_weights(desc),
              {{DNNL_ARG_DIFF_DST, moved(dy, desc.diff_dst_desc())},
               {DNNL_ARG_SRC, moved(x, desc.src_desc())},
               {DNNL_ARG_DIFF_WEIGHTS, dw}},
              dw, w_dims, Tag::oihw, layer.dw_wide);
    }
    return c;
  } catch (const dnnl::error&) {
    return std::nullopt;  // this pass is not offered by this algorithm
  }
}

struct Arguments {
  int64_t batch = 2;
  int repeats = 7;
  int threads = 0;
  std::string plot;
};

/// Time against error of one way to do a pass, over the layers.
using Points = std::map<std::string, ChartSeries>;

/// A chart a pass.
std::string draw(const std::map<ConvPass, Points>& passes) {
  constexpr int kWidth = 720, kHeight = 220;
  std::vector<std::string> charts;
  for (const auto& [pass, points] : passes) {
    std::vector<ChartSeries> series;
    for (const auto& [name, one] : points) series.push_back(one);
    charts.push_back(render_chart(series, {.title = std::string(to_string(pass)),
                                           .x_label = "time / direct products at the machine's peak",
                                           .log_y = true,
                                           .lines = false,
                                           .width = kWidth,
                                           .height = kHeight}));
  }
  return chart_sheet(charts, 1, kWidth, kHeight);
}

void run(const Arguments& arguments) {
  set_num_threads(arguments.threads);
  const Machine machine = measure_machine();
  const dnnl_version_t* const version = dnnl_version();
  fmt::print(
      "3x3 layers, batch {}, float32, {} threads, {}: {:.0f} GFLOP/s of fused multiply-adds; oneDNN "
      "{}.{}.{}\n\n",
      arguments.batch, num_threads(), machine.instruction_set, machine.gflops, version->major, version->minor,
      version->patch);
  fmt::print(
      "| layer | pass | way | ms | GFLOP/s | of peak | error | ratio "
      "|\n|---|---|---|---:|---:|---:|---:|---:|\n");
  const std::map<std::string, std::string> colours{{"opaline direct", "#08519c"},
                                                   {"opaline F(2x2)", "#3182bd"},
                                                   {"opaline F(4x4)", "#6baed6"},
                                                   {"oneDNN direct", "#a63603"},
                                                   {"oneDNN Winograd", "#fd8d3c"}};
  std::map<ConvPass, Points> plot;
  struct Size {
    int64_t size, in, out;
  };
  for (const Size& size :
       {Size{256, 64, 64}, {128, 128, 128}, {64, 256, 256}, {32, 512, 512}, {128, 256, 128}, {256, 16, 16}}) {
    const Layer layer = make_layer(arguments.batch, size.size, size.in, size.out);
    const double work = 2e-9 * static_cast<double>(layer.dy.numel() * layer.weight.numel() / layer.shape.out);
    for (const ConvPass pass : {ConvPass::kForward, ConvPass::kInputGradient, ConvPass::kWeightGradient}) {
      std::vector<Contender> contenders{ours(layer, pass, 0), ours(layer, pass, 2), ours(layer, pass, 4)};
      for (const bool winograd : {false, true}) {
        if (auto contender = theirs(layer, pass, winograd)) contenders.push_back(std::move(*contender));
      }
      std::vector<std::vector<double>> seconds(contenders.size());
      for (int i = -1; i < arguments.repeats; ++i) {
        for (size_t k = 0; k < contenders.size(); ++k) {
          const double begin = wall_seconds();
          contenders[k].run();
          if (i >= 0) seconds[k].push_back(wall_seconds() - begin);
        }
      }
      std::map<std::string, double> medians;
      for (size_t k = 0; k < contenders.size(); ++k) medians[contenders[k].name] = median(seconds[k]);
      const Tensor& reference = pass == ConvPass::kForward         ? layer.y_wide
                                : pass == ConvPass::kInputGradient ? layer.dx_wide
                                                                   : layer.dw_wide;
      for (const Contender& c : contenders) {
        c.finish();
        const double mine = medians[c.name], size_of_error = error(c.result, reference);
        ChartSeries& points = plot[pass][c.name];
        points.name = c.name;
        points.colour = colours.at(c.name);
        points.points.push_back({mine * machine.gflops / work, size_of_error});
        // Ours against oneDNN's of the same kind, and its direct one where it has no Winograd.
        std::string peer = c.name == "opaline direct" ? "oneDNN direct" : "oneDNN Winograd";
        if (!medians.contains(peer)) peer = "oneDNN direct";
        const bool compared = c.name.starts_with("opaline") && medians.contains(peer);
        fmt::print("| {}, {} -> {} | {} | {} | {:.2f} | {:.0f} | {:.0f} % | {:.1e} | {} |\n", size.size,
                   size.in, size.out, to_string(pass), c.name, 1e3 * mine, work / mine,
                   100.0 * work / mine / machine.gflops, size_of_error,
                   compared ? fmt::format("{:.2f} of {}", medians[peer] / mine, peer.substr(7)) : "");
        std::fflush(stdout);
      }
    }
  }
  if (!arguments.plot.empty()) write_file_atomically(arguments.plot, draw(plot));
}

}  // namespace
}  // namespace opaline::bench

int main(int argc, char** argv) {
  CLI::App app{
      "Convolutions of the networks' sizes, ours and oneDNN's in turns: medians, the rate by the direct "
      "count, its\n"
      "share of the machine's peak and the root-mean-square error against float64. Moving data to oneDNN's "
      "layouts is\n"
      "not timed; transforming weights is, on both sides."};
  opaline::bench::Arguments arguments;
  app.add_option("--batch", arguments.batch, "Images")->check(CLI::PositiveNumber)->capture_default_str();
  app.add_option("--repeats", arguments.repeats, "Turns")->check(CLI::PositiveNumber)->capture_default_str();
  app.add_option("--threads", arguments.threads, "0: all cores")->capture_default_str();
  app.add_option("--plot", arguments.plot, "Time against error, as SVG into this file");
  CLI11_PARSE(app, argc, argv);
  try {
    opaline::limit_instruction_set();
    opaline::bench::run(arguments);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "bench_onednn: %s\n", error.what());
    return 1;
  }
  return 0;
}
