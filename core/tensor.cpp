#include "core/tensor.h"

#include <algorithm>
#include <cstring>

#include "core/autograd.h"
#include "core/memory.h"

namespace opaline {

/// What copies of a tensor share beyond its values, and what a node keeps of its inputs.
struct Tensor::History {
  bool requires_grad = false;
  Tensor grad;
  std::shared_ptr<Node> node;

  History() = default;
  History(const History&) = delete;
  History& operator=(const History&) = delete;

  ~History();
};

struct Tensor::Impl {
  Shape shape;
  DType dtype = DType::kFloat32;
  std::shared_ptr<std::byte> storage;  // null for an edge and for values to recompute
  std::weak_ptr<std::byte> elsewhere;  // the storage then, for as long as somebody else keeps it
  std::shared_ptr<const ActiveSites> sites;
  std::shared_ptr<const Recompute> recompute;
  int recompute_depth = 0;  // recomputations, one after the other, that lead here from values that are kept
  std::shared_ptr<History> history = std::make_shared<History>();
};

// A long graph would otherwise die by recursion, one stack frame a node.
Tensor::History::~History() {
  std::vector<std::shared_ptr<Node>> dying;
  if (node) dying.push_back(std::move(node));
  while (!dying.empty()) {
    const std::shared_ptr<Node> last = std::move(dying.back());
    dying.pop_back();
    if (last.use_count() > 1) continue;
    for (Tensor& input : last->inputs) {
      if (!input.impl_ || input.impl_.use_count() > 1) continue;
      std::shared_ptr<History>& history = input.impl_->history;
      if (history.use_count() == 1 && history->node) dying.push_back(std::move(history->node));
    }
  }
}

int64_t size_of(DType dtype) {
  return dtype == DType::kFloat32 ? 4 : 8;
}

std::string to_string(DType dtype) {
  switch (dtype) {
    case DType::kFloat32:
      return "float32";
    case DType::kFloat64:
      return "float64";
    case DType::kInt64:
      return "int64";
  }
  return "unknown";
}

std::string to_string(const Shape& shape) {
  return shape.empty() ? "scalar" : fmt::format("{}", fmt::join(shape, "x"));
}

int64_t numel(const Shape& shape) {
  int64_t product = 1;
  for (const int64_t size : shape) product *= size;
  return product;
}

Tensor::Tensor(Shape shape, DType dtype) {
  int64_t bytes = size_of(dtype);
  for (const int64_t size : shape) {
    if (size < 0) fail("tensor", "negative size in shape {}", to_string(shape));
    if (__builtin_mul_overflow(bytes, size, &bytes)) {
      fail("tensor", "shape {} has more elements than memory has addresses", to_string(shape));
    }
  }
  auto storage = tensor_pool().allocate(bytes);
  impl_ = std::make_shared<Impl>(Impl{.shape = std::move(shape),
                                      .dtype = dtype,
                                      .storage = std::move(storage),
                                      .elsewhere = {},
                                      .sites = {},
                                      .recompute = {}});
}

Tensor Tensor::zeros(Shape shape, DType dtype) {
  Tensor result(std::move(shape), dtype);
  std::memset(result.bytes(), 0, static_cast<size_t>(result.byte_size()));
  return result;
}

Tensor Tensor::full(Shape shape, double value, DType dtype) {
  Tensor result(std::move(shape), dtype);
  result.fill(value);
  return result;
}

template <class T>
Tensor Tensor::from(std::span<const T> values, Shape shape) {
  if (static_cast<int64_t>(values.size()) != opaline::numel(shape)) {
    fail("tensor", "{} values for shape {}", values.size(), to_string(shape));
  }
  Tensor result(std::move(shape), dtype_of<T>());
  std::copy(values.begin(), values.end(), result.data<T>());
  return result;
}
template Tensor Tensor::from(std::span<const float>, Shape);
template Tensor Tensor::from(std::span<const double>, Shape);
template Tensor Tensor::from(std::span<const int64_t>, Shape);

Tensor Tensor::from(std::initializer_list<double> values, Shape shape, DType dtype) {
  return from(std::span<const double>(values.begin(), values.size()), std::move(shape)).to(dtype);
}

const Tensor::Impl& Tensor::impl() const {
  if (!impl_) fail("tensor", "is undefined");
  return *impl_;
}

Tensor::Impl& Tensor::impl() {
  if (!impl_) fail("tensor", "is undefined");
  return *impl_;
}

const Shape& Tensor::shape() const {
  return impl().shape;
}

int64_t Tensor::size(int64_t d) const {
  const int64_t index = d < 0 ? d + dim() : d;
  if (index < 0 || index >= dim()) fail("tensor", "no dimension {} in shape {}", d, to_string(shape()));
  return shape()[static_cast<size_t>(index)];
}

int64_t Tensor::numel() const {
  return opaline::numel(shape());
}

DType Tensor::dtype() const {
  return impl().dtype;
}

const std::byte* Tensor::bytes() const {
  if (!impl().storage)
    fail("tensor", "{} has no values here: read it through restored()", to_string(shape()));
  return impl().storage.get();
}

std::byte* Tensor::bytes() {
  return const_cast<std::byte*>(std::as_const(*this).bytes());
}

template <class T>
const T* Tensor::data() const {
  if (dtype() != dtype_of<T>()) {
    fail("tensor", "holds {}, read as {}", to_string(dtype()), to_string(dtype_of<T>()));
  }
  return reinterpret_cast<const T*>(bytes());
}
template const float* Tensor::data() const;
template const double* Tensor::data() const;
template const int64_t* Tensor::data() const;

template <class T>
T* Tensor::data() {
  return const_cast<T*>(std::as_const(*this).data<T>());
}
template float* Tensor::data();
template double* Tensor::data();
template int64_t* Tensor::data();

const std::shared_ptr<const ActiveSites>& Tensor::sites() const {
  return impl().sites;
}

Tensor& Tensor::set_sites(std::shared_ptr<const ActiveSites> sites) {
  if (sites && (dim() != 2 || size(0) != sites->count())) {
    fail("tensor", "{} cannot be {} active sites", to_string(shape()), sites->count());
  }
  impl().sites = std::move(sites);
  return *this;
}

double Tensor::at(int64_t i) const {
  if (i < 0 || i >= numel()) fail("tensor", "no element {} in shape {}", i, to_string(shape()));
  switch (dtype()) {
    case DType::kFloat32:
      return static_cast<double>(data<float>()[i]);
    case DType::kFloat64:
      return data<double>()[i];
    case DType::kInt64:
      return static_cast<double>(data<int64_t>()[i]);
  }
  return 0.0;
}

double Tensor::item() const {
  if (numel() != 1) fail("tensor", "item() of a tensor of shape {}", to_string(shape()));
  return at(0);
}

Tensor Tensor::clone() const {
  Tensor result(shape(), dtype());
  result.impl().sites = sites();
  std::memcpy(result.bytes(), bytes(), static_cast<size_t>(byte_size()));
  return result;
}

namespace {

template <class From, class To>
void convert(const Tensor& from, Tensor& to) {
  std::transform(from.data<From>(), from.data<From>() + from.numel(), to.data<To>(),
                 [](From value) { return static_cast<To>(value); });
}

template <class From>
void convert_from(const Tensor& from, Tensor& to) {
  switch (to.dtype()) {
    case DType::kFloat32:
      return convert<From, float>(from, to);
    case DType::kFloat64:
      return convert<From, double>(from, to);
    case DType::kInt64:
      return convert<From, int64_t>(from, to);
  }
}

}  // namespace

Tensor Tensor::to(DType dtype) const {
  if (dtype == this->dtype()) return detach();
  Tensor result(shape(), dtype);
  result.impl().sites = sites();
  switch (this->dtype()) {
    case DType::kFloat32:
      convert_from<float>(*this, result);
      break;
    case DType::kFloat64:
      convert_from<double>(*this, result);
      break;
    case DType::kInt64:
      convert_from<int64_t>(*this, result);
      break;
  }
  return result;
}

void Tensor::copy_from(const Tensor& other) {
  if (other.shape() != shape() || other.dtype() != dtype()) {
    fail("tensor", "cannot copy {} {} into {} {}", to_string(other.dtype()), to_string(other.shape()),
         to_string(dtype()), to_string(shape()));
  }
  std::memcpy(bytes(), other.bytes(), static_cast<size_t>(byte_size()));
}

void Tensor::fill(double value) {
  switch (dtype()) {
    case DType::kFloat32:
      std::fill_n(data<float>(), numel(), static_cast<float>(value));
      break;
    case DType::kFloat64:
      std::fill_n(data<double>(), numel(), value);
      break;
    case DType::kInt64:
      std::fill_n(data<int64_t>(), numel(), static_cast<int64_t>(value));
      break;
  }
}

Tensor Tensor::detach() const {
  return view(shape());
}

Tensor Tensor::view(Shape shape) const {
  if (opaline::numel(shape) != numel()) {
    fail("view", "{} elements of shape {} do not fit shape {}", numel(), to_string(this->shape()),
         to_string(shape));
  }
  const bool same = shape == this->shape();
  Tensor result;
  result.impl_ = std::make_shared<Impl>(Impl{.shape = std::move(shape),
                                             .dtype = dtype(),
                                             .storage = impl().storage,
                                             .elsewhere = {},
                                             .sites = same ? sites() : nullptr,
                                             .recompute = {}});
  return result;
}

void Tensor::set_recompute(Recompute recompute, std::span<const Tensor> inputs) {
  constexpr int kMaxDepth = 4;
  int depth = 1;
  for (const Tensor& input : inputs) {
    if (input.defined()) depth = std::max(depth, 1 + input.impl().recompute_depth);
  }
  if (depth > kMaxDepth) return;
  impl().recompute = std::make_shared<const Recompute>(std::move(recompute));
  impl().recompute_depth = depth;
}

bool Tensor::recomputes() const {
  return impl().recompute != nullptr;
}

Tensor Tensor::saved() const {
  if (!recomputes()) return detach();
  Tensor result = edge();
  result.impl_->history = std::make_shared<History>();
  return result;
}

Tensor Tensor::edge() const {
  Tensor result;
  result.impl_ = std::make_shared<Impl>(impl());
  if (impl().storage) result.impl_->elsewhere = impl().storage;
  result.impl_->storage = nullptr;
  return result;
}

Tensor Tensor::restored() const {
  if (impl().storage) return *this;
  if (std::shared_ptr<std::byte> storage = impl().elsewhere.lock()) {
    Tensor result = *this;
    result.impl_ = std::make_shared<Impl>(impl());
    result.impl_->storage = std::move(storage);
    return result;
  }
  if (!recomputes()) return {};
  const NoGradGuard no_grad;
  return (*impl().recompute)();
}

bool Tensor::requires_grad() const {
  return impl().history->requires_grad || impl().history->node != nullptr;
}

Tensor& Tensor::set_requires_grad(bool on) {
  if (on && !is_floating()) fail("tensor", "{} cannot have a gradient", to_string(dtype()));
  impl().history->requires_grad = on;
  return *this;
}

Tensor Tensor::grad() const {
  return impl().history->grad;
}

void Tensor::set_grad(Tensor grad) {
  impl().history->grad = std::move(grad);
}

const std::shared_ptr<Node>& Tensor::node() const {
  return impl().history->node;
}

void Tensor::set_node(std::shared_ptr<Node> node) {
  impl().history->node = std::move(node);
}

bool Tensor::shared() const {
  return impl_.use_count() > 1 || impl().storage.use_count() > 1;
}

const void* Tensor::id() const {
  return impl_ ? impl_->history.get() : nullptr;
}

}  // namespace opaline
