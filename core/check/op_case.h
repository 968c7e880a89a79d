// The registry of operation cases: for each operation of core/ops the inputs that are worth trying, how to
// call it, and a naive float64 reference. It drives the comparison with the references, the gradient checks,
// the golden values from PyTorch (scripts/golden/ops.py), the micro-benchmark and `opaline gradcheck`; a test
// fails where an operation has no case.
//
// To add an operation: its reference in reference.h, its cases in the cases_*.cpp of its family.
#pragma once

#include <filesystem>
#include <functional>
#include <map>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/check/array.h"
#include "core/random.h"
#include "core/tensor.h"

namespace opaline::check {

/// Fills an input from a stream.
using Fill = std::function<void(std::span<double>, Random&)>;

namespace fill {
Fill normal(double scale = 1.0, double offset = 0.0);
Fill uniform(double low, double high);
/// Normal numbers, none closer than `margin` to a point: for functions with kinks there.
Fill away_from(std::vector<double> points, double margin = 0.1);
/// Evenly spaced numbers in (-1, 1) in random order: every maximum is unique.
Fill distinct();
/// Zeros and ones; the first `empty` values are zeros whatever `coverage` says.
Fill mask(double coverage = 0.6, int64_t empty = 0);
/// These values, repeated as often as needed.
Fill values(std::vector<double> list);
}  // namespace fill

struct InputSpec {
  std::string name;
  Shape shape;
  Fill fill = fill::normal();
  bool differentiable = true;
  bool updated = false;  ///< overwritten by the operation: compared as a result too
};

/// What a reference computes: the result, and each updated input, in order.
struct ReferenceResult {
  Array y;
  std::vector<Array> updated;
  ReferenceResult(Array result, std::vector<Array> updated_inputs = {})
      : y(std::move(result)), updated(std::move(updated_inputs)) {}
};

/// Largest errors, relative to the largest magnitude of what is expected.
struct Tolerances {
  double float64 = 1e-12;          ///< result against the reference
  double float32 = 1e-5;           ///< result against the float64 reference
  double float32_gradient = 1e-4;  ///< gradients against those in float64
  double gradient = 1e-6;          ///< float64 gradients against difference quotients
  double golden = 1e-11;           ///< float64 results and gradients against PyTorch's
};

struct OpCase {
  std::string name;  ///< "operation/variant"
  std::vector<InputSpec> inputs;
  std::function<Tensor(std::span<const Tensor>)> forward;
  std::function<ReferenceResult(std::span<const Array>)> reference;
  /// The operation's options as scripts/golden/ops.py needs them: JSON values by name.
  std::map<std::string, std::string> options = {};
  /// Whether difference quotients make sense: not at a kink, nor with infinities.
  bool smooth = true;
  /// Whether PyTorch has such an operation, for golden values.
  bool in_pytorch = true;
  Tolerances tolerances = {};
  Fill cotangent = fill::normal();  ///< what the result is multiplied by before it is summed

  std::string_view operation() const { return std::string_view(name).substr(0, name.find('/')); }
  std::string_view variant() const { return std::string_view(name).substr(name.find('/') + 1); }
};

/// All cases in a fixed order.
const std::vector<OpCase>& op_cases();
/// Cases with the layers' real channel counts on images of side x side, for the benchmark.
std::vector<OpCase> large_op_cases(int64_t side = 256);

/// The case's inputs. Values are representable in float32, so all types see the same numbers; they depend on
/// the case's name alone. Differentiable inputs require a gradient.
std::vector<Tensor> make_inputs(const OpCase& op_case, DType dtype);
/// The cotangent of a result of this shape; drawn in the same way.
Tensor make_cotangent(const OpCase& op_case, const Shape& shape, DType dtype);

/// A case's options and the names of its inputs (all, differentiable, updated) as JSON.
std::string describe(const OpCase& op_case);
/// Writes inputs, cotangents and descriptions of all cases: what scripts/golden/ops.py reads.
void write_case_inputs(const std::filesystem::path& path);

// One function a family; those of one cases_*.cpp file stand together.
std::vector<OpCase> conv_cases();
std::vector<OpCase> linear_cases();
std::vector<OpCase> norm_cases();
std::vector<OpCase> activation_cases();
std::vector<OpCase> unary_cases();
std::vector<OpCase> arithmetic_cases();
std::vector<OpCase> pool_cases();
std::vector<OpCase> resize_cases();
std::vector<OpCase> reduce_cases();
std::vector<OpCase> shape_cases();
std::vector<OpCase> loss_cases();
std::vector<OpCase> sites_cases();

std::vector<OpCase> large_conv_cases(int64_t side);
std::vector<OpCase> large_linear_cases(int64_t side);
std::vector<OpCase> large_norm_cases(int64_t side);
std::vector<OpCase> large_pointwise_cases(int64_t side);
std::vector<OpCase> large_spatial_cases(int64_t side);
std::vector<OpCase> large_shape_cases(int64_t side);
std::vector<OpCase> large_loss_cases(int64_t side);

}  // namespace opaline::check
