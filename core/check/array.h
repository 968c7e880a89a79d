// The plain float64 array that references compute on: no pool, no autograd, nothing shared with what they
// check.
#pragma once

#include <cstdint>
#include <initializer_list>
#include <vector>

#include "core/tensor.h"

namespace opaline::check {

struct Array {
  Shape shape;
  std::vector<double> values;  ///< row-major

  Array() = default;
  explicit Array(Shape s) : shape(std::move(s)), values(static_cast<size_t>(numel(shape)), 0.0) {}
  explicit Array(const Tensor& tensor);

  int64_t size(size_t d) const { return shape[d]; }
  int64_t last() const { return shape.back(); }
  int64_t count() const { return static_cast<int64_t>(values.size()); }
  double& operator[](int64_t i) { return values[static_cast<size_t>(i)]; }
  double operator[](int64_t i) const { return values[static_cast<size_t>(i)]; }

  /// Element at these indices, one a dimension.
  template <class... Index>
  double& operator()(Index... index) {
    return values[offset({static_cast<int64_t>(index)...})];
  }
  template <class... Index>
  double operator()(Index... index) const {
    return values[offset({static_cast<int64_t>(index)...})];
  }

 private:
  size_t offset(std::initializer_list<int64_t> index) const {
    int64_t at = 0;
    size_t d = 0;
    for (const int64_t i : index) at = at * shape[d++] + i;
    return static_cast<size_t>(at);
  }
};

/// Largest |finite value|; 0 where there is none.
double largest_magnitude(const Array& array);

/// Largest |actual - expected| over the largest finite |expected|, or over `floor` where that is more (over 1
/// where both are 0). Where a value is
/// expected that is not finite, only that value has no error. Infinite where the error is not a number or
/// shapes differ.
double relative_error(const Array& actual, const Array& expected, double floor = 0.0);

/// Keeps the worst of errors; NaN is the worst of all and stays.
void include_error(double& worst, double error);

}  // namespace opaline::check
