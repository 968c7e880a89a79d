#!/usr/bin/python3
"""The loader's peer: PyTorch's DataLoader over the released layout, as its users read it.

A sample of stage 1 is the four polariser images, max, min, mask and normal (PNG), depth.npy and coeffs.npy; stage 2
reads the four pure-BSDF images too: twelve PNGs. They are decoded with PIL, stacked, masked and mapped to 2 v - 1.

With --ours the two loaders take turns, so that a loaded machine slows both:

    bench/peers/loader_pytorch.py SET/released --ours build/release/bench_loader SET/opaline

Packages: scripts/setup.sh --peers.
"""
import argparse
import os
import resource
import statistics
import subprocess
import time

import numpy as np
import torch
from PIL import Image

ANGLES = ("0", "45", "90", "135")


def read_rgb(path):
    return np.asarray(Image.open(path).convert("RGB"), dtype=np.float32) / 255


class Released(torch.utils.data.Dataset):
    def __init__(self, root, stage):
        self.stage = stage
        with open(os.path.join(root, "train.csv"), encoding="ascii") as file:
            self.rows = [line.strip().split(";") for line in file if line.strip()]
        self.folders = [os.path.join(root, "train", row[0]) for row in self.rows]

    def __len__(self):
        return len(self.rows)

    def __getitem__(self, index):
        folder, row = self.folders[index], self.rows[index]
        mask = np.asarray(Image.open(os.path.join(folder, "mask.png")).convert("L")) == 255
        m = mask[..., None].astype(np.float32)
        images = [read_rgb(os.path.join(folder, name + ".png")) * m for name in ANGLES + ("max", "min")]
        x = np.concatenate([2 * image - 1 for image in images] + [2 * m - 1], axis=2)
        sample = {
            "input": torch.from_numpy(x.transpose(2, 0, 1).copy()),
            "mask": torch.from_numpy(m.transpose(2, 0, 1).copy()),
            "normal": torch.from_numpy(
                ((2 * read_rgb(os.path.join(folder, "normal.png")) - 1) * m).transpose(2, 0, 1).copy()),
            "depth": torch.from_numpy(np.load(os.path.join(folder, "depth.npy"))[None].astype(np.float32) * m[..., 0]),
            "sh": torch.from_numpy(np.load(os.path.join(folder, "coeffs.npy"))[:9].T.astype(np.float32).copy()),
            "sss": torch.tensor([float(v) for v in [row[7]] + row[5].split(",") + row[6].split(",")]),
        }
        if self.stage == 2:
            bsdf = [2 * read_rgb(os.path.join(folder, name + "_BSDF.png")) - 1 for name in ANGLES]
            sample["bsdf"] = torch.from_numpy(np.concatenate(bsdf, axis=2).transpose(2, 0, 1).copy())
            sample["polarised"] = sample["input"][:12]
        return sample


def cpu_seconds():
    own = resource.getrusage(resource.RUSAGE_SELF)
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime


def measure(root, stage, workers, batch, epochs):
    """Samples a second and CPU seconds a sample, the start of the workers left out of the first."""
    loader = torch.utils.data.DataLoader(
        Released(root, stage), batch_size=batch, shuffle=True, num_workers=workers, persistent_workers=True)
    cpu = cpu_seconds()
    for _ in loader:
        pass
    begin = time.perf_counter()
    for _ in range(epochs):
        for _ in loader:
            pass
    seconds = time.perf_counter() - begin
    samples = epochs * len(loader.dataset)
    del loader  # ends the workers: their time counts from then on
    return samples / seconds, (cpu_seconds() - cpu) / (samples + samples / epochs)


def measure_ours(program, data, seconds):
    """{(stage, threads): (samples a second, CPU seconds a sample, kB)}"""
    output = subprocess.run([program, data, "--seconds", str(seconds), "--threads", "1", "2"],
                            check=True, capture_output=True, text=True).stdout
    result = {}
    for line in output.splitlines():
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        if len(cells) == 7 and cells[0] in ("1", "2") and cells[1] == "whole":
            result[int(cells[0]), int(cells[2])] = (float(cells[3]), float(cells[4]) / 1e3, float(cells[5]))
    return result


def files_kb(root, stage):
    names = [n + ".png" for n in ANGLES + ("max", "min", "mask", "normal")] + ["depth.npy", "coeffs.npy"]
    if stage == 2:
        names += [n + "_BSDF.png" for n in ANGLES]
    folders = Released(root, stage).folders
    return sum(os.path.getsize(os.path.join(f, n)) for f in folders for n in names) / len(folders) / 1e3


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n", maxsplit=1)[0])
    parser.add_argument("root", help="released layout (bench_convert --layout released)")
    parser.add_argument("--ours", nargs=2, metavar=("BENCH_LOADER", "DATA"), help="takes turns with our loader")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--batch", type=int, default=8)
    parser.add_argument("--epochs", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--seconds", type=float, default=1.5)
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    peer, ours = {1: [], 2: []}, {}
    for _ in range(arguments.rounds):
        for stage in (1, 2):
            peer[stage].append(
                measure(arguments.root, stage, arguments.workers, arguments.batch, arguments.epochs))
        if arguments.ours:
            for key, value in measure_ours(*arguments.ours, arguments.seconds).items():
                ours.setdefault(key, []).append(value)
    median = lambda rows, i: statistics.median(row[i] for row in rows)
    print("| loader | stage | threads | samples/s | CPU ms/sample | kB/sample |\n|---|---|---:|---:|---:|---:|")
    for stage, rows in peer.items():
        print(f"| PyTorch DataLoader, PNG | {stage} | {arguments.workers} workers | {median(rows, 0):.0f} | "
              f"{1e3 * median(rows, 1):.2f} | {files_kb(arguments.root, stage):.0f} |")
    for (stage, threads), rows in sorted(ours.items()):
        print(f"| opaline | {stage} | {threads} | {median(rows, 0):.0f} | {1e3 * median(rows, 1):.2f} | "
              f"{median(rows, 2):.0f} |")
    for stage in (1, 2):
        if (stage, 2) in ours:
            print(f"\nstage {stage}: {median(ours[stage, 2], 0) / median(peer[stage], 0):.1f} times the samples a "
                  f"second, 1/{median(peer[stage], 1) / median(ours[stage, 2], 1):.1f} of the CPU time", end="")
    print()


if __name__ == "__main__":
    main()
