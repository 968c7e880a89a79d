#include "core/tensor.h"

#include <catch2/catch.hpp>
#include <cstdint>
#include <span>
#include <vector>

namespace opaline {
namespace {

TEST_CASE("a tensor knows its shape, type and bytes") {
  const Tensor x({2, 3, 4}, DType::kFloat64);
  CHECK(x.dim() == 3);
  CHECK(x.numel() == 24);
  CHECK(x.size(0) == 2);
  CHECK(x.size(-1) == 4);
  CHECK(x.size(-3) == 2);
  CHECK(x.byte_size() == 192);
  CHECK(x.is_floating());
  CHECK_THROWS_WITH(x.size(3), Catch::Contains("dimension 3") && Catch::Contains("2x3x4"));
  CHECK_THROWS_AS(x.size(-4), Error);
  CHECK_THROWS_WITH(Tensor({2, -1}), Catch::Contains("2x-1"));
  CHECK(Tensor::scalar(2.5).shape().empty());
  CHECK(Tensor::scalar(2.5).item() == 2.5);
  CHECK(Tensor({0, 3}).numel() == 0);
  CHECK(to_string(Shape{}) == "scalar");
  CHECK(to_string(Shape{2, 256}) == "2x256");
  CHECK(to_string(DType::kInt64) == "int64");
}

TEST_CASE("storage is aligned for vectors") {
  for (const int64_t n : {1, 3, 17, 1000}) {
    const Tensor x({n});
    CHECK(reinterpret_cast<uintptr_t>(x.bytes()) % 64 == 0);
  }
}

TEST_CASE("a shape too large for memory is an error and not an overflow") {
  CHECK_THROWS_AS(Tensor({int64_t{1} << 40, int64_t{1} << 40}), Error);
  CHECK_THROWS_AS(Tensor({int64_t{1} << 62}), Error);
}

TEST_CASE("values are copied in and read out in row-major order") {
  const Tensor x = Tensor::from({1, 2, 3, 4, 5, 6}, {2, 3});
  CHECK(x.at(4) == 5.0);
  CHECK(x.values<float>()[5] == 6.0F);
  CHECK_THROWS_WITH(x.at(6), Catch::Contains("6") && Catch::Contains("2x3"));
  CHECK_THROWS_AS(x.at(-1), Error);
  CHECK_THROWS_WITH(x.data<double>(), Catch::Contains("float32") && Catch::Contains("float64"));
  CHECK_THROWS_WITH(x.item(), Catch::Contains("2x3"));
  const std::vector<double> three = {1, 2, 3};
  CHECK_THROWS_WITH(Tensor::from(std::span<const double>(three), {2, 2}),
                    Catch::Contains("3 values") && Catch::Contains("2x2"));
}

TEST_CASE("an undefined tensor says so") {
  const Tensor none;
  CHECK(!none.defined());
  CHECK_THROWS_WITH(none.shape(), Catch::Contains("undefined"));
  CHECK_THROWS_AS(none.dtype(), Error);
}

TEST_CASE("copies of a handle share storage, clones do not") {
  Tensor x = Tensor::from({1, 2}, {2});
  Tensor same = x;
  Tensor clone = x.clone();
  same.data<float>()[0] = 7.0F;
  CHECK(x.at(0) == 7.0);
  CHECK(clone.at(0) == 1.0);
  CHECK(same.id() == x.id());
  CHECK(clone.id() != x.id());

  const Tensor detached = x.detach();
  CHECK(detached.bytes() == x.bytes());
  CHECK(detached.id() != x.id());
  const Tensor view = x.view({2, 1});
  CHECK(view.shape() == Shape{2, 1});
  CHECK(view.bytes() == x.bytes());
  CHECK_THROWS_WITH(x.view({3}), Catch::Contains("2") && Catch::Contains("3"));
}

TEST_CASE("conversion between types") {
  const Tensor x = Tensor::from({1.5, -2.0, 1e30}, {3}, DType::kFloat64);
  const Tensor narrow = x.to(DType::kFloat32);
  CHECK(narrow.dtype() == DType::kFloat32);
  CHECK(narrow.at(0) == 1.5);
  CHECK(narrow.at(2) == static_cast<double>(1e30F));
  CHECK(Tensor::from({3.0, -4.0}, {2}).to(DType::kInt64).values<int64_t>()[1] == -4);
  CHECK(x.to(DType::kFloat64).bytes() == x.bytes());
}

TEST_CASE("copy_from and fill overwrite") {
  Tensor x = Tensor::zeros({2, 2});
  x.copy_from(Tensor::from({1, 2, 3, 4}, {2, 2}));
  CHECK(x.at(3) == 4.0);
  x.fill(-1.0);
  CHECK(x.at(0) == -1.0);
  Tensor counts = Tensor::zeros({2}, DType::kInt64);
  counts.fill(3.0);
  CHECK(counts.values<int64_t>()[1] == 3);
  CHECK_THROWS_WITH(x.copy_from(Tensor::zeros({4})), Catch::Contains("2x2") && Catch::Contains("4"));
  CHECK_THROWS_AS(x.copy_from(Tensor::zeros({2, 2}, DType::kFloat64)), Error);
}

TEST_CASE("only floating tensors may want a gradient") {
  Tensor x = Tensor::zeros({2});
  CHECK(!x.requires_grad());
  CHECK(x.set_requires_grad(true).requires_grad());
  CHECK(!x.detach().requires_grad());
  CHECK(!x.clone().requires_grad());
  Tensor counts = Tensor::zeros({2}, DType::kInt64);
  CHECK_THROWS_WITH(counts.set_requires_grad(true), Catch::Contains("int64"));
}

}  // namespace
}  // namespace opaline
