#!/usr/bin/python3
"""Compares every network with PyTorch: the same random weights and inputs through `opaline forward` and
through networks.py: results, all gradients and updated buffers, in training and evaluation mode.

  scripts/parity/compare.py --size 32 --width 4      all networks, small: about 10 seconds
  scripts/parity/compare.py                          released sizes: about 20 minutes on 2 cores where PyTorch
                                                     finds OpenBLAS, over an hour with the reference BLAS

Expected: "ok" on every line and exit code 0. Errors are relative norms, |ours - reference| / |reference|,
against PyTorch in float64. Limits: float64 1e-9 forward and 1e-6 for each gradient; float32 1e-4 forward and
2e-2 for each gradient, or three times the error of PyTorch's own float32 where that is larger (a ReLU or
pooling choice that flips decides this, not the arithmetic). A gradient that is zero in exact arithmetic must
have a root mean square under 1e-2 of the median gradient's. These are for strict numerics; with balanced and
fast ones float32 has 1e-3 forward, and gradients are printed without a limit.
"""

import argparse
import gc
import math
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

import numpy as np
import torch

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "scripts" / "golden"), str(ROOT / "scripts" / "parity")]

import networks  # noqa: E402
import safetensors_io  # noqa: E402

FORWARD_LIMIT = {"float64": 1e-9, "float32": 1e-4}
LOOSE_FORWARD_LIMIT = 1e-3
GRADIENT_LIMIT = {"float64": 1e-6, "float32": 2e-2}
PEER_FACTOR = 3.0
ZERO_LIMIT = 1e-2
# A vector through a BatchNorm needs samples; images do not.
BATCH = {"illumination": 8, "illumination_decoder": 8, "sss": 8}
DEFAULT_BATCH = 2


def parse_arguments():
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--opaline", default=str(ROOT / "build" / "release" / "opaline"))
    parser.add_argument("--net", nargs="+", choices=networks.NAMES, default=networks.NAMES)
    parser.add_argument("--mode", nargs="+", choices=("train", "eval"), default=("train", "eval"))
    parser.add_argument("--dtype", nargs="+", choices=("float64", "float32"), default=("float64", "float32"))
    parser.add_argument("--numerics", nargs="+", choices=("strict", "balanced", "fast"),
                        default=("strict", "balanced", "fast"))
    parser.add_argument("--size", type=int, default=256, help="build size")
    parser.add_argument("--run-size", type=int, help="image size where it is not the build size")
    parser.add_argument("--width", type=int, default=64)
    parser.add_argument("--batch", type=int, help="images (default: 8 with a BatchNorm over vectors, else 2)")
    parser.add_argument("--variant", choices=("release", "paper"), default="release")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=2, help="of PyTorch")
    parser.add_argument("--verbose", action="store_true", help="one line a tensor")
    return parser.parse_args()


def run_torch(model, x, cotangent, dtype):
    """y, grad.* and buffer.* as arrays; leaves the model as it was."""
    state = {name: tensor.clone() for name, tensor in model.state_dict().items()}
    model.to(dtype)
    leaf = x.to(dtype).detach().requires_grad_(True)
    model.zero_grad(set_to_none=True)
    y = model(leaf)
    (y * cotangent.to(dtype)).sum().backward()
    result = {"y": y.detach().numpy(), "grad.x": leaf.grad.numpy()}
    for name, parameter in model.named_parameters():
        result["grad." + name] = parameter.grad.numpy()
    if model.training:
        for name, buffer in model.named_buffers():
            result["buffer." + name] = buffer.numpy().copy()
    model.zero_grad(set_to_none=True)
    model.to(torch.float64)
    model.load_state_dict(state)
    return result


def run_opaline(arguments, name, mode, dtype, numerics, folder):
    command = [arguments.opaline, "forward", name, "--grad", "--mode", mode, "--dtype", dtype, "--numerics", numerics,
               "--weights", str(folder / "weights.safetensors"),
               "--input", str(folder / "input.safetensors"),
               "--output", str(folder / "output.safetensors"),
               "--size", str(arguments.size), "--width", str(arguments.width),
               "--variant", arguments.variant, "--channels", str(networks.sizes(arguments.variant)[0])]
    subprocess.run(command, check=True)
    return safetensors_io.load(folder / "output.safetensors")


def relative_error(value, reference):
    if value.shape != reference.shape:
        return float("inf")
    difference = np.linalg.norm((value.astype(np.float64) - reference.astype(np.float64)).ravel())
    scale = np.linalg.norm(reference.astype(np.float64).ravel())
    return float(difference / scale) if scale > 0 else float(difference)


def root_mean_square(value):
    return float(np.sqrt(np.mean(np.square(value.astype(np.float64)))))


class Report:
    """Worst tensor of each kind, and whether all kept their limit."""

    def __init__(self, title, verbose):
        self.title, self.verbose, self.worst, self.violations = title, verbose, {}, []

    def check(self, kind, name, error, limit):
        if self.verbose:
            print(f"    {kind:8s} {name:60s} {error:.2e} (limit {limit:.1e})")
        if not error <= limit:
            self.violations.append(f"{kind} of {name}: {error:.3e} over {limit:.1e}")
        rank = (error / limit, error)
        if kind not in self.worst or not rank <= self.worst[kind][0]:
            self.worst[kind] = (rank, error, name)

    def finish(self, seconds):
        parts = [f"{kind} {error:.1e} ({name})" for kind, (_, error, name) in self.worst.items()]
        print(f"{self.title}: {'FAILED' if self.violations else 'ok'}; {'; '.join(parts)}; {seconds:.1f} s")
        for violation in self.violations:
            print(f"    {violation}")
        sys.stdout.flush()
        return not self.violations


def compare(ours, reference, peer, dtype, loose, zeros, report):
    """`loose`: gradients have no limit, and results a larger one."""
    if set(ours) != set(reference):
        report.violations.append(f"tensors differ: {sorted(set(ours) ^ set(reference))}")
        return
    typical = statistics.median(root_mean_square(value) for name, value in reference.items()
                                if name.startswith("grad.") and name[5:] not in zeros)
    for name, expected in reference.items():
        value = ours[name]
        if name.startswith("grad.") and name[5:] in zeros:
            report.check("zero", name, root_mean_square(value) / typical, math.inf if loose else ZERO_LIMIT)
        elif name.startswith("grad."):
            limit = math.inf if loose else GRADIENT_LIMIT[dtype]
            if peer is not None:
                limit = max(limit, PEER_FACTOR * relative_error(peer[name], expected))
            report.check("gradient", name, relative_error(value, expected), limit)
        else:
            kind = "forward" if name == "y" else "buffer"
            report.check(kind, name, relative_error(value, expected),
                         LOOSE_FORWARD_LIMIT if loose else FORWARD_LIMIT[dtype])


def compare_network(arguments, name, mode, folder):
    size = arguments.run_size or arguments.size
    batch = arguments.batch or BATCH.get(name, DEFAULT_BATCH)
    torch.manual_seed(arguments.seed)
    model = networks.make(name, arguments.width, arguments.size, arguments.variant)
    # Still in float32, so that both types start from equal weights.
    networks.randomize(model, arguments.seed, arguments.width)
    model.double().train(mode == "train")
    zeros = networks.zero_by_construction(model)
    shape = networks.input_shape(name, batch, size, arguments.variant)
    x = (2.0 * torch.rand(shape) - 1.0).double()
    with torch.no_grad():
        training, probe = model.training, model.eval()(x[:1])
        model.train(training)
    cotangent = torch.randn((batch, *probe.shape[1:])).double()
    safetensors_io.save(folder / "weights.safetensors", {k: v.numpy() for k, v in model.state_dict().items()})
    safetensors_io.save(folder / "input.safetensors", {"x": x.numpy(), "cotangent": cotangent.numpy()})

    begin = time.time()
    reference = run_torch(model, x, cotangent, torch.float64)
    print(f"  {name} {mode}: {batch} x {size}, PyTorch float64 {time.time() - begin:.1f} s")
    peer = run_torch(model, x, cotangent, torch.float32) if "float32" in arguments.dtype else None
    del model, x, cotangent, probe
    gc.collect()

    good = True
    for dtype in arguments.dtype:
        for numerics in arguments.numerics:
            begin = time.time()
            ours = run_opaline(arguments, name, mode, dtype, numerics, folder)
            report = Report(f"{name} {mode} {dtype} {numerics}", arguments.verbose)
            loose = dtype == "float32" and numerics != "strict"
            compare(ours, reference, peer if dtype == "float32" else None, dtype, loose, zeros, report)
            good = report.finish(time.time() - begin) and good
    return good


def main():
    arguments = parse_arguments()
    torch.set_num_threads(arguments.threads)
    good = True
    with tempfile.TemporaryDirectory() as folder:
        for name in arguments.net:
            for mode in arguments.mode:
                good = compare_network(arguments, name, mode, pathlib.Path(folder)) and good
    print("all within the limits" if good else "limits violated")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
