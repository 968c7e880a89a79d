#!/usr/bin/python3
"""Worst errors of every operation over hard inputs in float32, ours and PyTorch's on the same numbers.

  build/release/opaline bench stress --export /tmp/stress
  scripts/parity/stress.py /tmp/stress

prints the table of docs/numerics.md in about five seconds. Both are measured against the same float64 results and
scales (core/check/stress.h); "lost" counts cases in which no number came out although one in float32's range was to.
Expected: exit code 0, which says that opaline loses no more than PyTorch, and that in float64 NaN and infinities come
out where they come out of PyTorch.
"""

import argparse
import json
import pathlib
import sys

import numpy as np
import torch

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path.insert(0, str(ROOT / "scripts" / "golden"))

import ops  # noqa: E402
import safetensors_io  # noqa: E402

FLOAT32 = np.finfo(np.float32)
# Interpolation: both let 0 * infinity reach some neighbours of weight 0, but not the same ones.
SPREADS = {"upsample_bilinear"}


def run_torch(name, description, tensors, dtype):
    """Results by name: y, grad.*, updated.*; as arrays."""
    inputs = {}
    for key in description["inputs"]:
        inputs[key] = torch.from_numpy(tensors[f"{name}/{key}"].copy()).to(dtype)
        inputs[key].requires_grad_(key in description["differentiable"])
    y = ops.OPERATIONS[name.split("/")[0]](inputs, description["options"])
    y.backward(torch.from_numpy(tensors[f"{name}/cotangent"].copy()).to(dtype))
    results = {"y": y.detach()}
    for key in description["differentiable"]:
        grad = inputs[key].grad
        results["grad." + key] = torch.zeros_like(inputs[key]) if grad is None else grad
    for key in description["updated"]:
        results["updated." + key] = inputs[key]
    return {key: value.numpy() for key, value in results.items()}


def error(actual, expected, scale):
    """As Expected::error in core/check/stress.cpp: the largest error, and whether a number was lost."""
    actual = actual.astype(np.float64)
    size = np.broadcast_to(np.maximum(np.abs(scale), FLOAT32.tiny), expected.shape)
    size = np.where(np.isfinite(size), size, np.maximum(np.abs(expected), FLOAT32.tiny))
    in_range = (np.abs(expected) <= FLOAT32.max) & (size <= FLOAT32.max)
    number, wanted = np.isfinite(actual), np.isfinite(expected)
    lost = bool(np.any(~number & wanted & in_range))
    if np.any(number & ~wanted):
        return float("inf"), lost
    both = number & wanted
    return float(np.max(np.abs(actual[both] - expected[both]) / size[both], initial=0.0)), lost


class Row:
    """An operation's worst errors, forward and backward, and the number of cases that lost a number."""

    def __init__(self):
        self.ours, self.peer, self.where = [0.0, 0.0], [0.0, 0.0], ["-", "-"]
        self.ours_lost, self.peer_lost = 0, 0

    def include(self, ours, peer, where):
        for i in range(2):
            if ours[i] > self.ours[i]:
                self.ours[i], self.where[i] = ours[i], where
            self.peer[i] = max(self.peer[i], peer[i])


def surfacing_differences(wide, expected):
    """Results in which PyTorch, in float64, is not finite where the expected value is, or the other way round."""
    return [key for key, value in wide.items()
            if np.any(np.isfinite(value) != np.isfinite(expected[key]))]


def main():
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=pathlib.Path, help="what `opaline bench stress --export` wrote")
    parser.add_argument("--verbose", action="store_true", help="one line a case: PyTorch's errors")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    rows, differences = {}, []
    for path in sorted(arguments.folder.glob("*.safetensors")):
        tensors, metadata = safetensors_io.load_with_metadata(path)
        row = rows.setdefault(path.stem, Row())
        for name, text in sorted(metadata.items()):
            if name == "xxh64":
                continue
            description = json.loads(text)
            narrow = run_torch(name, description, tensors, torch.float32)
            expected = {key: tensors[f"{name}/expected.{key}"] for key in narrow}
            peer, peer_lost = [0.0, 0.0], False
            for key, value in narrow.items():
                worst, lost = error(value, expected[key], tensors[f"{name}/scale.{key}"])
                side = int(key.startswith("grad."))
                peer[side] = max(peer[side], worst)
                peer_lost = peer_lost or lost
            row.include([float(e) for e in description["ours"]], peer, name.split("/")[1])
            row.ours_lost += description["lost"]
            row.peer_lost += peer_lost
            if arguments.verbose:
                print(f"{name}: forward {peer[0]:.1e}, backward {peer[1]:.1e}{', lost' if peer_lost else ''}")
            wide = run_torch(name, description, tensors, torch.float64)
            if path.stem not in SPREADS:
                differences += [f"{name} {key}" for key in surfacing_differences(wide, expected)]

    print("| operation | worst forward | ours | PyTorch | worst backward | ours | PyTorch | lost | PyTorch |")
    print("|---|---|--:|--:|---|--:|--:|--:|--:|")
    for name, row in rows.items():
        print(f"| {name} | {row.where[0]} | {row.ours[0]:.1e} | {row.peer[0]:.1e} | {row.where[1]} | "
              f"{row.ours[1]:.1e} | {row.peer[1]:.1e} | {row.ours_lost} | {row.peer_lost} |")
    for text in differences:
        print(f"what is not finite differs from PyTorch's: {text}")
    bad = [name for name, row in rows.items()
           if not all(np.isfinite(row.ours)) or row.ours_lost > row.peer_lost]
    if bad:
        print(f"a number that should be none, or lost where PyTorch has one: {', '.join(bad)}")
    return 1 if bad or differences else 0


if __name__ == "__main__":
    sys.exit(main())
