#!/usr/bin/python3
"""Writes tests/models/golden/<network>.safetensors, what PyTorch gives for small networks in float64, non_finite
beside them, what becomes of a NaN, and tests/nn/golden/adam_steps.safetensors and adam_extremes.safetensors, steps of its Adam.

Weights, inputs and cotangents come from an integer hash (pattern below, also in nn/pattern.h), so
the files hold results only: for every tensor its norm and three projections on hashed vectors, and a sample
of y.
Takes a few seconds:  scripts/parity/make_golden.py
"""

import math
import pathlib
import sys

import numpy as np
import torch

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "scripts" / "golden"), str(ROOT / "scripts" / "parity")]

import networks  # noqa: E402
import safetensors_io  # noqa: E402

# At width 4 the decoder's last hidden layer has one channel, and its ReLU may die.
WIDTH = {name: 16 if name == "illumination_decoder" else 4 for name in networks.NAMES}
BUILD_SIZE = 32
# Where the image differs from the build size, encoders average their maps to the grid they were built for.
RUN_SIZE = {"illumination": 48, "sss": 64}
INPUT, COTANGENT, PROBES = 1000, 1001, (2000, 2001, 2002)


def pattern(shape, tag):
    """Numbers in (-1, 1) that depend on the tag and the row-major index alone."""
    mask = np.uint64(0xFFFFFFFF)
    h = (np.arange(math.prod(shape), dtype=np.uint64) * np.uint64(2654435761)
         + np.uint64((tag + 1) * 2246822519)) & mask
    h = ((h ^ (h >> np.uint64(15))) * np.uint64(2246822519)) & mask
    h = ((h ^ (h >> np.uint64(13))) * np.uint64(3266489917)) & mask
    h = h ^ (h >> np.uint64(16))
    return ((h.astype(np.float64) + 0.5) / 2.0**31 - 1.0).reshape(shape)


def set_state(model):
    with torch.no_grad():
        for tag, (name, tensor) in enumerate(model.state_dict().items()):
            value = torch.from_numpy(pattern(tuple(tensor.shape), tag))
            if name.endswith("num_batches_tracked"):
                tensor.fill_(3)
            elif name.endswith("running_mean"):
                tensor.copy_(0.1 * value)
            elif name.endswith("running_var"):
                tensor.copy_(1.0 + 0.5 * value)
            elif tensor.dim() > 1:
                tensor.copy_(0.14 * value)
            elif name.endswith("weight"):
                tensor.copy_(1.0 + 0.2 * value)
            else:
                tensor.copy_(0.2 * value)


def summary(tensor):
    """Norm and projections, the latter divided by the root of the number of elements."""
    value = tensor.detach().double().numpy().ravel()
    projections = [value @ pattern(value.shape, tag) / math.sqrt(value.size) for tag in PROBES]
    return [np.linalg.norm(value), *projections]


def results(name, mode):
    model = networks.make(name, WIDTH[name], BUILD_SIZE).double()
    set_state(model)
    model.train(mode == "train")
    batch = 2 if name in ("normal", "depth", "reconstruction") else 8
    shape = networks.input_shape(name, batch, RUN_SIZE.get(name, BUILD_SIZE))
    x = torch.from_numpy(pattern(shape, INPUT)).requires_grad_(True)
    y = model(x)
    (y * torch.from_numpy(pattern(tuple(y.shape), COTANGENT))).sum().backward()
    sample = y.detach().numpy()
    if sample.ndim == 4:
        sample = np.ascontiguousarray(sample[:, :, ::8, ::8])
    found = {"shape": np.array(shape, dtype=np.int64), "y": np.array(summary(y)), "y_sample": sample,
             "gradients": np.array([summary(x.grad)] + [summary(p.grad) for p in model.parameters()])}
    if mode == "train":
        found["buffers"] = np.array([summary(buffer) for buffer in model.buffers()])
    return {f"{mode}.{key}": value for key, value in found.items()}


def non_finite(name, mode, value):
    """How many numbers are not finite where one value of the second input is not: in the output, the input's gradient
    and each parameter's."""
    model = networks.make(name, WIDTH[name], BUILD_SIZE).double()
    set_state(model)
    model.train(mode == "train")
    batch = 2 if name in ("normal", "depth", "reconstruction") else 8
    shape = networks.input_shape(name, batch, BUILD_SIZE)
    x = pattern(shape, INPUT)
    x[(1, 1, BUILD_SIZE // 2, BUILD_SIZE // 2)[:x.ndim]] = value
    x = torch.from_numpy(x).requires_grad_(True)
    y = model(x)
    (y * torch.from_numpy(pattern(tuple(y.shape), COTANGENT))).sum().backward()
    tensors = [y, x.grad] + [p.grad for p in model.parameters()]
    return np.array([int((~torch.isfinite(t)).sum()) for t in tensors], dtype=np.int64)


def adam_steps(dtype):
    """Three parameters through ten steps at a falling rate; the last has no gradient in steps 3 to 5."""
    shapes = {"a": (7, 5), "b": (3, 2, 3, 3), "c": (11,)}
    parameters = {name: torch.nn.Parameter(torch.from_numpy(pattern(shape, tag)).to(dtype))
                  for tag, (name, shape) in enumerate(shapes.items())}
    optimizer = torch.optim.Adam(parameters.values(), lr=2e-2, betas=(0.5, 0.999), eps=1e-8)
    found = {}
    for step in range(10):
        for group in optimizer.param_groups:
            group["lr"] = 2e-2 * (1.0 - max(0.0, step - 5) / 5)
        for tag, (name, parameter) in enumerate(parameters.items()):
            gradient = torch.from_numpy(pattern(shapes[name], 100 * (step + 1) + tag)).to(dtype)
            parameter.grad = None if name == "c" and 3 <= step <= 5 else gradient
        optimizer.step()
        for name, parameter in parameters.items():
            found[f"{step}.{name}"] = parameter.detach().numpy().copy()
    for name, parameter in parameters.items():
        state = optimizer.state[parameter]
        found[f"exp_avg.{name}"] = state["exp_avg"].numpy()
        found[f"exp_avg_sq.{name}"] = state["exp_avg_sq"].numpy()
        found[f"step.{name}"] = np.array(int(state["step"]), dtype=np.int64)
    return found


# A column an element, a row a step. From zero: a step of 1e-32 shows.
EXTREME_GRADIENTS = np.array([
    [0.0, -0.0, 1e-45, 1e-38, -1e-38, 1e-30, 1e-20, 1e-8, 1.0, 1e10, 1e18, 1e20, 1e30, -1e30, 3e38, 1e30],
    [0.0, 0.0, 1e-45, 1e-38, 1e-38, 1e-30, 1e-20, 1e-8, -1.0, 1e10, 1e19, 1e20, 1e30, 1e30, 3e38, 1.0],
    [0.0, 1.0, 0.0, 1.0, 1e-38, 1e30, -1e-20, 1e-12, 1e-30, 1e-10, 0.0, 1e-20, 1e-30, 0.0, -3e38, 1.0],
    [0.0, -0.0, 1e-45, 1e-38, -1e-38, 1e-30, 1e-20, 1e-8, 1.0, 1e10, 1e18, 0.0, 1e30, -1e30, 0.0, 1.0],
])


def adam_extremes(dtype):
    """Adam under gradients of 0, 1e-45 to 3e38 and changes between them."""
    parameter = torch.nn.Parameter(torch.zeros(EXTREME_GRADIENTS.shape[1], dtype=dtype))
    optimizer = torch.optim.Adam([parameter], lr=2e-4, betas=(0.5, 0.999), eps=1e-8)
    found = {}
    for step, gradient in enumerate(EXTREME_GRADIENTS):
        parameter.grad = torch.from_numpy(gradient.astype(np.float32)).to(dtype)
        optimizer.step()
        state = optimizer.state[parameter]
        for name, tensor in (("p", parameter), ("exp_avg", state["exp_avg"]), ("exp_avg_sq", state["exp_avg_sq"])):
            found[f"{step}.{name}"] = tensor.detach().numpy().copy()
    return found


def main():
    torch.set_num_threads(1)
    models = ROOT / "tests" / "models" / "golden"
    for name in networks.NAMES:
        safetensors_io.save(models / f"{name}.safetensors", results(name, "train") | results(name, "eval"))
    safetensors_io.save(models / "non_finite.safetensors", {
        f"{name}.{mode}.{kind}": non_finite(name, mode, value) for name in networks.NAMES
        for mode in ("train", "eval") for kind, value in (("nan", math.nan), ("infinity", math.inf))})
    nn = ROOT / "tests" / "nn" / "golden"
    nn.mkdir(exist_ok=True)
    found = {f"{key}.{name}": value for key, dtype in (("float64", torch.float64), ("float32", torch.float32))
             for name, value in adam_steps(dtype).items()}
    safetensors_io.save(nn / "adam_steps.safetensors", found)
    found = {f"{key}.{name}": value for key, dtype in (("float64", torch.float64), ("float32", torch.float32))
             for name, value in adam_extremes(dtype).items()}
    safetensors_io.save(nn / "adam_extremes.safetensors", found | {"gradients": EXTREME_GRADIENTS})


if __name__ == "__main__":
    main()
