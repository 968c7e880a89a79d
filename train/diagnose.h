// Where a value that is not finite came from.
#pragma once

#include <string>
#include <vector>

#include "core/tensor.h"
#include "data/encode.h"
#include "nn/module.h"

namespace opaline {

/// The first operation, in the order of computation, whose result is not finite although its inputs are, told
/// by the parameters around it: "conv2d with sss.model.4.weight". A parameter or an input that is itself not
/// finite is named as such. Walks the graph of `root`, so call it before backward() consumes that. Empty
/// where all is finite.
std::string first_non_finite(const Tensor& root, const std::vector<NamedTensor>& parameters);

/// The first tensor of a batch that is not finite and the scenes that it is of: "the normal of train-13";
/// empty where all are finite. What a loss compares with is not in its graph, so this is asked first.
std::string first_non_finite(const Batch& batch);

/// The parameter nearest to the loss whose gradient is not finite (the gradient passed it first); empty where
/// all are finite.
std::string first_non_finite_gradient(const std::vector<NamedTensor>& parameters);

}  // namespace opaline
