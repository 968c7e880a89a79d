// Tensor: a shape and a type over shared, contiguous storage, and the handle of autograd.
//
// Layout. Images are N x H x W x C inside the engine (channels last: every kernel's inner loop runs over
// channels); files, weights and tests speak N x C x H x W, and to_nchw / to_nhwc in core/ops/shape.h are the
// border. Weights keep PyTorch's shapes everywhere (conv O x I x KH x KW, linear out x in). Images of which
// only some pixels exist are sites x C and know their active sites (core/active_sites.h): operations on
// images take either, and those that change no pixel's place hand the sites on.
#pragma once

#include <cstddef>
#include <cstdint>
#include <functional>
#include <initializer_list>
#include <memory>
#include <span>
#include <string>
#include <type_traits>
#include <vector>

#include "core/active_sites.h"
#include "core/error.h"

namespace opaline {

enum class DType { kFloat32, kFloat64, kInt64 };

using Shape = std::vector<int64_t>;

/// Bytes of one element.
int64_t size_of(DType dtype);
/// "float32", "float64" or "int64".
std::string to_string(DType dtype);
/// "2x256x256x20"; "scalar" for no dimensions.
std::string to_string(const Shape& shape);
/// Product of the dimensions (1 for a scalar).
int64_t numel(const Shape& shape);

template <class T>
constexpr DType dtype_of() {
  if constexpr (std::is_same_v<T, float>) return DType::kFloat32;
  if constexpr (std::is_same_v<T, double>) return DType::kFloat64;
  if constexpr (std::is_same_v<T, int64_t>) return DType::kInt64;
}

/// Calls f.template operator()<T>() with T = float or double; other types are an error that names `where`.
template <class F>
decltype(auto) dispatch_floating(std::string_view where, DType dtype, F&& f) {
  if (dtype == DType::kFloat32) return f.template operator()<float>();
  if (dtype == DType::kFloat64) return f.template operator()<double>();
  fail(where, "needs float32 or float64, got {}", to_string(dtype));
}

struct Node;  // core/autograd.h

class Tensor;
/// Makes a tensor's values once more, to the last bit.
using Recompute = std::function<Tensor()>;

/// A cheap handle: copies share storage and gradient. A default-made Tensor is undefined.
class Tensor {
 public:
  Tensor() = default;
  /// Uninitialised storage, 64-byte aligned, from the pool (core/memory.h).
  explicit Tensor(Shape shape, DType dtype = DType::kFloat32);

  static Tensor zeros(Shape shape, DType dtype = DType::kFloat32);
  static Tensor full(Shape shape, double value, DType dtype = DType::kFloat32);
  /// Copies `values` in row-major order; their number must be the shape's.
  template <class T>
  static Tensor from(std::span<const T> values, Shape shape);
  static Tensor from(std::initializer_list<double> values, Shape shape, DType dtype = DType::kFloat32);
  static Tensor scalar(double value, DType dtype = DType::kFloat32) { return full({}, value, dtype); }

  bool defined() const { return impl_ != nullptr; }
  const Shape& shape() const;
  /// Size of dimension d; negative d counts from the end.
  int64_t size(int64_t d) const;
  int64_t dim() const { return static_cast<int64_t>(shape().size()); }
  int64_t numel() const;
  DType dtype() const;
  bool is_floating() const { return dtype() != DType::kInt64; }

  /// Elements in row-major order; T must be the tensor's type.
  template <class T>
  const T* data() const;
  template <class T>
  T* data();
  template <class T>
  std::span<const T> values() const {
    return {data<T>(), static_cast<size_t>(numel())};
  }
  template <class T>
  std::span<T> values() {
    return {data<T>(), static_cast<size_t>(numel())};
  }
  const std::byte* bytes() const;
  std::byte* bytes();
  int64_t byte_size() const { return numel() * size_of(dtype()); }

  /// Element i (row-major) as double, whatever the type.
  double at(int64_t i) const;
  /// The only element as double.
  double item() const;

  /// A copy with its own storage, without history.
  Tensor clone() const;
  /// A copy in another type (itself, detached, where the type is the same), without history.
  Tensor to(DType dtype) const;
  /// Overwrites this tensor's elements; shape and type must agree.
  void copy_from(const Tensor& other);
  void fill(double value);

  /// The pixels that these rows are; null for anything else.
  const std::shared_ptr<const ActiveSites>& sites() const;
  /// Makes the rows of this tensor (sites.count() x C) those pixels; null takes that back.
  Tensor& set_sites(std::shared_ptr<const ActiveSites> sites);

  // --- autograd (core/autograd.h) ---
  /// The same storage without history: what operations save for their backward pass.
  Tensor detach() const;
  /// The same storage under another shape with as many elements, without history or, for another shape,
  /// sites.
  Tensor view(Shape shape) const;
  bool requires_grad() const;
  /// Makes this a leaf that collects a gradient (or not).
  Tensor& set_requires_grad(bool on);
  /// Accumulated gradient; undefined before the first backward pass.
  Tensor grad() const;
  void set_grad(Tensor grad);
  void zero_grad() { set_grad({}); }
  /// The operation that made this tensor; null for a leaf.
  const std::shared_ptr<Node>& node() const;
  void set_node(std::shared_ptr<Node> node);
  /// Whether another handle or tensor has the same values: if not, they may be taken over instead of copied.
  bool shared() const;
  /// Identity of the tensor in a graph: equal for copies of one handle and for its edge.
  const void* id() const;

  /// Says how the values can be made again at little cost from `inputs`, so that a graph need not keep them.
  /// Ignored where the inputs would have to be made again themselves, a few times over.
  void set_recompute(Recompute recompute, std::span<const Tensor> inputs);
  bool recomputes() const;
  /// What an operation keeps of a tensor for its backward pass, without history: the values, or the way to
  /// make them again. Read it through restored().
  Tensor saved() const;
  /// The history without the values: what a node keeps of its inputs.
  Tensor edge() const;
  /// A tensor with values: itself, or they are found or made again. Undefined where an edge's are gone.
  Tensor restored() const;

 private:
  struct History;
  struct Impl;
  std::shared_ptr<Impl> impl_;
  const Impl& impl() const;
  Impl& impl();
};

}  // namespace opaline
