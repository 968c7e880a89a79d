#!/usr/bin/python3
"""The engine's peer: the same networks in PyTorch (scripts/parity/networks.py), training steps and forward passes.

    bench/peers/step_pytorch.py --net normal stage2 --size 256 --batch 2
    bench/peers/step_pytorch.py --net cascade --forward --size 256 --batch 1

For every network `opaline bench step` and PyTorch take turns on the same number of threads, so that a loaded machine
slows both; what is printed are medians over all turns. PyTorch runs the faster of its memory formats (contiguous and
channels last), with oneDNN, in inference mode where only the forward pass is timed, and with an environment that suits
it: waiting threads sleep, for those of its backward pass are others, and freed memory is kept instead of given back
and cleared anew (--environment default leaves both as they are). Memory is what a step needs
beyond parameters and their gradients: for PyTorch the growth of the process's peak over its size before the first
forward pass, less the gradients; for opaline the peak of its pool, less the same.

Single networks are also compared in their errors, in training mode: `opaline bench net` is given PyTorch's weights
and inputs, and each side is held against its own float64. Errors are root mean squares of differences over those of
the values, of the result and of the gradients of all parameters together. Shares of the machine's multiply-adds and of
its bandwidth are those of opaline's step there.

Packages: scripts/setup.sh --peers. Any newer PyTorch of a virtual environment (with NumPy) can run it too, and with
--compile its networks are compiled first; that is not timed.
"""
import argparse
import copy
import ctypes
import gc
import json
import math
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

import torch

# What the system's allocator and OpenMP read as a process begins.
TUNED = {"OMP_WAIT_POLICY": "passive", "MALLOC_MMAP_THRESHOLD_": str(1 << 33), "MALLOC_TRIM_THRESHOLD_": str(1 << 34),
         "MALLOC_TOP_PAD_": str(1 << 28)}
ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "scripts" / "golden"), str(ROOT / "scripts" / "parity")]

import networks  # noqa: E402
import safetensors_io  # noqa: E402

STAGES = ("stage1", "stage2", "cascade")
IMAGE_CHANNELS, BSDF_CHANNELS, SH_VALUES, SSS_VALUES = 21, 12, 27, 8


def parse_arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--net", nargs="+", default=["normal", "sss", "stage1", "stage2"],
                        choices=networks.NAMES + STAGES)
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--batch", type=int, default=2)
    parser.add_argument("--width", type=int, default=64)
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=3, help="turns of each side")
    parser.add_argument("--repeats", type=int, default=3, help="timed runs a turn")
    parser.add_argument("--forward", action="store_true", help="the forward pass alone, in evaluation mode")
    parser.add_argument("--numerics", default="balanced", choices=("strict", "balanced", "fast"),
                        help="opaline's choice of algorithms")
    parser.add_argument("--environment", default="tuned", choices=("tuned", "default"), help="of PyTorch")
    parser.add_argument("--compile", action="store_true", help="torch.compile the networks (PyTorch 2 and newer)")
    parser.add_argument("--opaline", default=str(ROOT / "build" / "release" / "opaline"))
    parser.add_argument("--json", action="store_true", help="one JSON object a network")
    arguments = parser.parse_args()
    if arguments.compile and not hasattr(torch, "compile"):
        parser.error(f"--compile: PyTorch {torch.__version__} has no torch.compile; run this with a newer one")
    return arguments


def runnable(net, arguments):
    """What is called in place of a network. Each memory format is compiled for itself, whole, or it is an error."""
    return torch.compile(net, dynamic=False, fullgraph=True) if arguments.compile else net


class Stage:
    """The networks of a stage and the losses of the release."""

    def __init__(self, name, arguments):
        size, width = arguments.size, arguments.width
        wanted = ["normal", "depth", "illumination"]
        if name != "stage1":
            wanted += ["illumination_decoder", "sss"]
        if name == "stage2":
            wanted.append("reconstruction")
        self.nets = torch.nn.ModuleDict({n: networks.make(n, image_size=size, width=width) for n in wanted})
        self.run = {n: runnable(net, arguments) for n, net in self.nets.items()}
        batch = arguments.batch
        self.image = torch.rand(batch, IMAGE_CHANNELS, size, size) * 2 - 1
        self.bsdf = torch.rand(batch, BSDF_CHANNELS, size, size) * 2 - 1
        self.mask = torch.ones(batch, 1, size, size)
        self.normal = torch.rand(batch, 3, size, size)
        self.depth = torch.rand(batch, 1, size, size)
        self.sh = torch.rand(batch, SH_VALUES)
        self.sss = torch.rand(batch, SSS_VALUES)

    def parameters(self):
        return self.nets.parameters()

    def modules(self):
        return self.nets.modules()

    def to(self, memory_format):
        self.nets.to(memory_format=memory_format)
        self.image = self.image.contiguous(memory_format=memory_format)
        self.bsdf = self.bsdf.contiguous(memory_format=memory_format)

    def train(self, on):
        self.nets.train(on)

    def masked_l1(self, x, target):
        error = (x - target).abs() * self.mask
        return (error.sum((1, 2, 3)) / (self.mask.sum((1, 2, 3)) * x.shape[1])).mean()

    def forward(self):
        normal = self.run["normal"](self.image)
        depth = self.run["depth"](self.image)
        sh = self.run["illumination"](self.image)
        outputs = [normal, depth, sh]
        if "sss" in self.nets:
            map_ = self.run["illumination_decoder"](sh)
            sss = self.run["sss"](torch.cat([map_, normal, depth, self.image], dim=1))
            outputs.append(sss)
        if "reconstruction" in self.nets:
            values = sss[:, :, None, None].expand(-1, -1, *self.image.shape[2:])
            outputs.append(self.run["reconstruction"](torch.cat([self.bsdf, values], dim=1)))
        return outputs

    def backward(self, outputs):
        mse = torch.nn.functional.mse_loss
        loss = (100 * self.masked_l1(outputs[0], self.normal) + self.masked_l1(outputs[1], self.depth) +
                0.1 * mse(outputs[2], self.sh))
        if len(outputs) > 3:
            loss = loss + mse(outputs[3], self.sss)
        if len(outputs) > 4:
            loss = loss + self.masked_l1(outputs[4], self.bsdf)
        loss.backward()


class Single:
    """One network; the gradient of the sum of its result times a cotangent."""

    def __init__(self, name, arguments):
        self.net = networks.make(name, image_size=arguments.size, width=arguments.width)
        self.run = runnable(self.net, arguments)
        self.x = torch.rand(networks.input_shape(name, arguments.batch, arguments.size)) * 2 - 1
        self.cotangent = None

    def parameters(self):
        return self.net.parameters()

    def modules(self):
        return self.net.modules()

    def to(self, memory_format):
        self.net.to(memory_format=memory_format)
        if self.x.dim() == 4:
            self.x = self.x.contiguous(memory_format=memory_format)

    def train(self, on):
        self.net.train(on)

    def forward(self):
        return self.run(self.x)

    def backward(self, y):
        if self.cotangent is None:
            self.cotangent = torch.rand_like(y) * 2 - 1
        y.backward(self.cotangent)


def run_peer(step, forward_only):
    """Seconds of one run."""
    begin = time.perf_counter()
    if forward_only:
        with torch.inference_mode():
            step.forward()
    else:
        step.backward(step.forward())
    seconds = time.perf_counter() - begin
    for parameter in step.parameters():
        parameter.grad = None
    return seconds


def resident(field):
    with open("/proc/self/status", encoding="ascii") as file:
        for line in file:
            if line.startswith(field):
                return int(line.split()[1]) * 1024
    raise RuntimeError(f"no {field} in /proc/self/status")


def reset_peak():
    with open("/proc/self/clear_refs", "w", encoding="ascii") as file:
        file.write("5")


def peer_memory(step, forward_only):
    """Bytes of a run beyond what was there before it and the gradients."""
    reset_peak()
    before = resident("VmRSS")
    run_peer(step, forward_only)
    gradients = 0 if forward_only else sum(p.numel() * p.element_size() for p in step.parameters())
    return resident("VmHWM") - before - gradients


def trim():
    """Gives freed memory back to the system."""
    gc.collect()
    ctypes.CDLL("libc.so.6").malloc_trim(0)


def choose_format(step, forward_only):
    """The faster memory format, and its name."""
    timings = {}
    for name, memory_format in (("contiguous", torch.contiguous_format), ("channels last", torch.channels_last)):
        step.to(memory_format)
        run_peer(step, forward_only)
        timings[name] = (min(run_peer(step, forward_only) for _ in range(2)), memory_format)
    best = min(timings, key=lambda name: timings[name][0])
    step.to(timings[best][1])
    run_peer(step, forward_only)  # where it is compiled once more for the inputs' new storage
    return best


def relative_error(values, reference):
    """Root mean square of the differences over that of the reference, of all tensors together."""
    difference = sum((v.double() - r).square().sum().item() for v, r in zip(values, reference))
    return math.sqrt(difference / sum(r.square().sum().item() for r in reference))


def peer_errors(step):
    """PyTorch's in float32, as it was timed, against its float64: of the result, of all parameters' gradients."""
    def run(call, net, dtype):
        y = call(step.x.to(dtype))
        y.backward(step.cotangent.to(dtype))
        gradients = [parameter.grad for parameter in net.parameters()]
        for parameter in net.parameters():
            parameter.grad = None
        return [y.detach()], gradients

    wide = copy.deepcopy(step.net).double()
    expected = run(wide, wide, torch.float64)
    return [relative_error(v, e) for v, e in zip(run(step.run, step.net, torch.float32), expected)]


def our_row(arguments, net, step):
    """What `opaline bench net` tells of the peer's weights and inputs."""
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        weights, inputs = folder / "weights.safetensors", folder / "input.safetensors"
        safetensors_io.save(weights, {k: v.numpy() for k, v in step.net.state_dict().items()})
        safetensors_io.save(inputs, {"x": step.x.numpy(), "cotangent": step.cotangent.numpy()})
        command = [arguments.opaline, "bench", "net", "--net", net, "--size", str(arguments.size), "--width",
                   str(arguments.width), "--threads", str(arguments.threads), "--repeats", str(arguments.repeats),
                   "--weights", str(weights), "--input", str(inputs), "--json"]
        rows = json.loads(subprocess.run(command, check=True, capture_output=True, text=True).stdout)["rows"]
    return next(row for row in rows if row["numerics"] == arguments.numerics)


def compare_errors(arguments, net, step):
    row = our_row(arguments, net, step)
    result, gradients = peer_errors(step)
    return {"peak_share": row["peak_share"], "copy_share": row["copy_share"],
            "ours_result_error": row["result_error"], "ours_gradient_error": row["parameter_gradient_error"],
            "peer_result_error": result, "peer_gradient_error": gradients}


def run_ours(arguments, net):
    command = [arguments.opaline, "bench", "step", "--net", net, "--size", str(arguments.size), "--batch",
               str(arguments.batch), "--width", str(arguments.width), "--repeats", str(arguments.repeats), "--json",
               "--numerics", arguments.numerics]
    if arguments.forward:
        command.append("--forward")
    environment = {key: value for key, value in os.environ.items() if key not in TUNED}
    environment["OMP_NUM_THREADS"] = str(arguments.threads)
    return json.loads(subprocess.run(command, check=True, capture_output=True, text=True, env=environment).stdout)


def compare(arguments, net):
    torch.manual_seed(1)
    if arguments.compile:
        torch._dynamo.reset()  # of one forward function only so many variants are kept
    step = Stage(net, arguments) if net in STAGES else Single(net, arguments)
    step.train(not arguments.forward)
    for module in step.modules():
        if isinstance(module, torch.nn.ReLU):
            module.inplace = True
    if arguments.compile:
        run_peer(step, arguments.forward)  # compiles
    trim()  # what earlier networks and compiling left free must not serve this one unseen
    memory = peer_memory(step, arguments.forward)
    memory_format = choose_format(step, arguments.forward)
    ours, peer = [], []
    for _ in range(arguments.rounds):
        ours.append(run_ours(arguments, net))
        peer += [run_peer(step, arguments.forward) for _ in range(arguments.repeats)]
    ours_seconds = statistics.median(o["seconds"] for o in ours)
    peer_seconds = statistics.median(peer)
    result = {"net": net, "ours_seconds": ours_seconds, "peer_seconds": peer_seconds,
            "ratio": peer_seconds / ours_seconds, "ours_gflops": statistics.median(o["gflops"] for o in ours),
            "ours_bytes": ours[0].get("beyond_parameters_bytes", ours[0]["peak_bytes"]),
            "peer_bytes": memory, "peer_format": memory_format}
    if isinstance(step, Single) and not arguments.forward:
        result.update(compare_errors(arguments, net, step))
    return result


def columns(result):
    """The shares and errors of a single network; empty for the others."""
    if "peak_share" not in result:
        return ["", "", "", ""]
    return [f"{100 * result['peak_share']:.0f} %", f"{100 * result['copy_share']:.0f} %"] + [
        f"{result[side + '_result_error']:.1e}, {result[side + '_gradient_error']:.1e}" for side in ("ours", "peer")]


def main():
    arguments = parse_arguments()
    if arguments.environment == "tuned" and any(os.environ.get(key) != value for key, value in TUNED.items()):
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **TUNED})
    torch.set_num_threads(arguments.threads)
    what = "forward" if arguments.forward else "forward and backward"
    if not arguments.json:
        print(f"{what}, {arguments.batch} x {arguments.size} x {arguments.size}, width {arguments.width}, "
              f"{arguments.threads} threads, {arguments.numerics}, PyTorch {torch.__version__}, "
              f"{arguments.environment} environment{', compiled' if arguments.compile else ''}; errors of the result and of the gradients")
        print("| network | opaline s | GFLOP/s | of peak | of copying | PyTorch s | its format | ratio | opaline MiB | "
              "PyTorch MiB | opaline errors | PyTorch errors |")
        print("|---|---:|---:|---:|---:|---:|---|---:|---:|---:|---:|---:|")
    for net in arguments.net:
        r = compare(arguments, net)
        if arguments.json:
            print(json.dumps(r), flush=True)
            continue
        peak, copying, ours, theirs = columns(r)
        print(f"| {net} | {r['ours_seconds']:.3f} | {r['ours_gflops']:.0f} | {peak} | {copying} | "
              f"{r['peer_seconds']:.3f} | {r['peer_format']} | {r['ratio']:.2f} | {r['ours_bytes'] / 2**20:.0f} | "
              f"{r['peer_bytes'] / 2**20:.0f} | {ours} | {theirs} |", flush=True)


if __name__ == "__main__":
    main()
