#!/usr/bin/python3
"""Errors of every network over hard inputs in float32, ours and PyTorch's, against PyTorch in float64.

  scripts/parity/stress_networks.py [--numerics strict]

prints the second table of docs/numerics.md in ten seconds. Errors are relative norms, |float32 - float64| / |float64|;
a gradient's norm counts at least a thousandth of the largest gradient's, so that one that is zero in exact arithmetic
has a scale too. Expected: exit code 0, which says that all is finite where PyTorch in float64 is, and that opaline's
errors are at most 1e-4, or ten times PyTorch's, or on a gradient 5e-2 (what one ReLU that chooses differently costs).
Of an image without structure, maxima are equal; which of them takes the input's gradient is rounding's choice where
Winograd's algorithm runs, so that gradient is then compared with --numerics strict only.
"""

import argparse
import pathlib
import sys
import tempfile

import numpy as np
import torch

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "scripts" / "golden"), str(ROOT / "scripts" / "parity")]

import compare  # noqa: E402
import networks  # noqa: E402
import safetensors_io  # noqa: E402

# From numbers in (-1, 1).
INPUTS = {
    "usual": lambda x: x,
    "tiny": lambda x: 1e-30 * x,
    "huge": lambda x: 1e30 * x,
    "denormal": lambda x: 1e-40 * x,
    "constant": lambda x: np.full_like(x, 0.7),
    "zeros": lambda x: np.copysign(0.0, x),
    "offset": lambda x: 1e3 + x,
}
FLAT = {"tiny", "denormal", "constant", "zeros"}
LIMITS, FACTOR = (1e-4, 5e-2), 10.0


def errors(found, reference, with_input=True):
    """Forward and backward; infinite where something is not finite."""
    norms = {key: np.linalg.norm(value.astype(np.float64)) for key, value in reference.items()}
    largest = max(norm for key, norm in norms.items() if key.startswith("grad."))
    worst = [0.0, 0.0]
    for key, norm in norms.items():
        if (key != "y" and not key.startswith("grad.")) or (key == "grad.x" and not with_input):
            continue
        floor = 1e-3 * largest if key not in ("y", "grad.x") else 0.0
        difference = np.linalg.norm(found[key].astype(np.float64) - reference[key])
        error = difference / max(norm, floor, np.finfo(np.float32).tiny)
        side = int(key != "y")
        worst[side] = max(worst[side], float(error) if np.isfinite(error) else float("inf"))
    return worst


def main():
    parser = argparse.ArgumentParser(description=__doc__,
                                     formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--opaline", default=str(ROOT / "build" / "release" / "opaline"))
    parser.add_argument("--verbose", action="store_true", help="one line an input")
    parser.add_argument("--numerics", choices=("strict", "balanced", "fast"), default="balanced")
    arguments = parser.parse_args()
    arguments.size, arguments.width, arguments.variant = 32, 8, "release"
    torch.set_num_threads(1)
    good = True
    print("| network | worst forward | ours | PyTorch | worst backward | ours | PyTorch |")
    print("|---|---|--:|--:|---|--:|--:|")
    with tempfile.TemporaryDirectory() as name_of_folder:
        folder = pathlib.Path(name_of_folder)
        for name in networks.NAMES:
            torch.manual_seed(1)
            model = networks.make(name, arguments.width, arguments.size, arguments.variant)
            networks.randomize(model, 1, arguments.width)
            model.double()
            shape = networks.input_shape(name, compare.BATCH.get(name, compare.DEFAULT_BATCH), arguments.size)
            usual = np.random.default_rng(1).uniform(-1.0, 1.0, shape)
            safetensors_io.save(folder / "weights.safetensors",
                                {k: v.numpy() for k, v in model.state_dict().items()})
            for mode in ("train", "eval"):
                model.train(mode == "train")
                rows = {}
                for kind, transform in INPUTS.items():
                    x = torch.from_numpy(transform(usual).astype(np.float32)).double()
                    with torch.no_grad():
                        state = {k: v.clone() for k, v in model.state_dict().items()}
                        cotangent = torch.from_numpy(np.random.default_rng(2).uniform(-1.0, 1.0, model(x).shape))
                        model.load_state_dict(state)
                    safetensors_io.save(folder / "input.safetensors",
                                        {"x": x.numpy(), "cotangent": cotangent.numpy()})
                    reference = compare.run_torch(model, x, cotangent, torch.float64)
                    narrow = compare.run_torch(model, x, cotangent, torch.float32)
                    found = compare.run_opaline(arguments, name, mode, "float32", arguments.numerics, folder)
                    with_input = kind not in FLAT or arguments.numerics == "strict"
                    peer = errors(narrow, reference, with_input)
                    ours = errors(found, reference, with_input)
                    rows[kind] = (ours, peer)
                    if arguments.verbose:
                        print(f"{name} {mode} {kind}: ours {ours[0]:.1e}, {ours[1]:.1e}; "
                              f"PyTorch {peer[0]:.1e}, {peer[1]:.1e}")
                    good = good and all(o <= max(limit, FACTOR * p) for o, p, limit in zip(ours, peer, LIMITS))
                cells = [f"{name}, {mode}"]
                for side in range(2):
                    worst = max(rows, key=lambda kind: rows[kind][0][side])
                    cells += [worst, f"{rows[worst][0][side]:.1e}",
                              f"{max(peer[side] for _, peer in rows.values()):.1e}"]
                print(f"| {' | '.join(cells)} |")
    print("within the limits" if good else "over the limits")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
