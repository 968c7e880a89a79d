#!/usr/bin/env python3
"""Compares `opaline bench render` with Mitsuba 3: the error of S0 in equal time on the scenes that both express.

  python3 -m venv peer && peer/bin/pip install mitsuba numpy
  scripts/setup.sh --peers                       LLVM 19: older ones cannot compile what Mitsuba 3.9 generates
  OMP_WAIT_POLICY=passive peer/bin/python bench/peers/mitsuba_render.py     about 5 minutes on 2 cores
  ... --quick                                    a rough look, about 1 minute

Scenes: the body of `opaline bench render` with a grey medium, under uniform light and under the flash alone. Both
renderers read the same mesh (facet normals), camera (box filter), index, medium and light. Mitsuba walks with
unlimited depth and its default roulette, independent samples.

  1. opaline exports the scenes with a converged reference.
  2. Every variant and integrator of Mitsuba runs on the uniform scene. What cannot run is named with its error; the
     one of the highest efficiency, polarised or not, goes on.
  3. The two alternate, one render each a round, on the same number of threads. Efficiency is 1 / (MSE x CPU time of
     the process); the ratio of two efficiencies is the ratio of times at equal error, since both errors fall as 1 /
     samples. opaline plans its samples for an error of S0; building its guide and its pilot samples count, and
     Mitsuba's kernels are compiled before the clock starts. Mitsuba's MSE is its renders' own variance (nothing of
     ours comes in), ours is against our reference, whose variance is subtracted.
  4. Mitsuba's mean over all rounds is compared with our reference: the mean difference, and the mean square
     difference over what the noise of both explains (1 where the images agree).

With --stokes also S1 and S2, for information: Mitsuba depolarises light where it scatters, opaline where it leaves
the medium, so what is reflected inside after its last scattering comes out with some polarisation in the former and
without in the latter. They are not the same quantity, and their times are not compared.
"""

import argparse
import glob
import json
import os
import pathlib
import re
import statistics
import subprocess
import sys
import tempfile
import time

ROOT = pathlib.Path(__file__).resolve().parents[2]
VARIANTS = ("llvm_ad_spectral_polarized", "llvm_ad_mono_polarized", "llvm_ad_spectral", "llvm_ad_rgb",
            "llvm_ad_mono", "scalar_spectral_polarized", "scalar_rgb")
INTEGRATORS = ("volpath", "volpathmis")
SCENES = ("uniform", "flash")
WANTED = {"uniform": 3.0, "flash": 30.0}


def parse_arguments():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--opaline", default=str(ROOT / "build" / "release" / "opaline"))
    parser.add_argument("--threads", type=int, default=2, help="of either renderer")
    parser.add_argument("--size", type=int, default=48)
    parser.add_argument("--error", type=float, nargs="+", default=[0.1, 0.05], help="errors asked of opaline")
    parser.add_argument("--peer-spp", type=int, default=256, help="samples of Mitsuba")
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--reference-spp", type=int, default=4096)
    parser.add_argument("--variants", nargs="+", default=VARIANTS)
    parser.add_argument("--integrators", nargs="+", default=INTEGRATORS)
    parser.add_argument("--stokes", action="store_true", help="look at S1 and S2 too")
    parser.add_argument("--quick", action="store_true", help="fewer variants, rounds and samples")
    parser.add_argument("--json", help="write the result to this file too")
    parser.add_argument("--worker", nargs=4, metavar=("SCENE", "VARIANT", "INTEGRATOR", "SPP"),
                        help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.quick:
        arguments.rounds, arguments.reference_spp, arguments.error = 4, 1024, [0.2]
        arguments.variants = ("llvm_ad_mono", "llvm_ad_mono_polarized")
    return arguments


def newest_llvm():
    """The shared library of the highest version that Debian's packages have installed, or None."""
    found = []
    for path in glob.glob("/usr/lib/*-linux-gnu/libLLVM*.so*"):
        match = re.search(r"libLLVM(?:-(\d+)\.so|\.so\.(\d+))", path)
        if match:
            found.append((int(match.group(1) or match.group(2)), path))
    return max(found)[1] if found else None


# --- Inside the worker: a process that holds one scene in one variant of Mitsuba.


def load_scene(mi, path, integrator):
    scene = json.loads(pathlib.Path(path).read_text())
    spectral = "spectral" in mi.variant()
    camera, medium, flash = scene["camera"], scene["medium"], scene["flash"]

    def radiance(value):
        return {"type": "uniform", "value": value} if spectral else {"type": "rgb", "value": [value] * 3}

    walk = {"type": "volpath" if integrator == "stokes" else integrator, "max_depth": -1}
    target = [a + b for a, b in zip(camera["position"], camera["looks_along"])]
    parts = {
        "type": "scene",
        "integrator": {"type": "stokes", "nested": walk} if integrator == "stokes" else walk,
        "sensor": {
            "type": "perspective",
            "fov": camera["horizontal_field_degrees"],
            "fov_axis": "x",
            "to_world": mi.ScalarTransform4f().look_at(camera["position"], target, [0, 1, 0]),
            "film": {"type": "hdrfilm", "width": camera["width"], "height": camera["height"],
                     "rfilter": {"type": "box"}, "pixel_format": "luminance", "component_format": "float32"},
            "sampler": {"type": "independent"},
        },
        "body": {
            "type": "ply",
            "filename": str(pathlib.Path(path).parent / scene["mesh"]),
            "face_normals": True,
            "bsdf": {"type": "dielectric", "int_ior": scene["index"], "ext_ior": 1.0},
            "interior": {"type": "homogeneous", "sigma_t": medium["sigma_t"], "albedo": medium["albedo"],
                         "phase": {"type": "hg", "g": medium["g"]}},
        },
    }
    if scene["environment_radiance"] > 0.0:
        parts["environment"] = {"type": "constant", "radiance": radiance(scene["environment_radiance"])}
    if flash["radiance"] > 0.0:
        # The camera stands on the sphere and looks away from it, so it does not see it.
        parts["flash"] = {"type": "sphere", "center": flash["centre"], "radius": flash["radius"],
                          "emitter": {"type": "area", "radiance": radiance(flash["radiance"])}}
    return mi.load_dict(parts)


def work(arguments):
    """Answers each line of standard input, a seed, with the costs of a render; at the end saves what it rendered."""
    import mitsuba as mi
    import numpy as np
    path, variant, integrator, spp = arguments.worker
    mi.set_variant(variant)
    mi.set_log_level(mi.LogLevel.Error)
    import drjit as dr
    dr.set_thread_count(arguments.threads)  # scalar variants use the same pool
    scene = load_scene(mi, path, integrator)
    # S0 alone, or the Stokes components after the plain image, each as often as the film has channels.
    pick = slice(0, 1) if integrator != "stokes" else None

    def render(seed):
        image = np.array(mi.render(scene, spp=int(spp), seed=seed)).astype(np.float64)
        if pick is not None:
            return image[..., pick]
        step = (image.shape[2] - 1) // 4
        return image[..., 1:1 + 3 * step:step]

    render(0)  # compiles
    print("ready", flush=True)
    images = []
    for line in sys.stdin:
        if line.startswith("save"):
            np.save(line.split(maxsplit=1)[1].strip(), np.stack(images))
            print("saved", flush=True)
            continue
        cpu, wall = time.process_time(), time.perf_counter()
        image = render(int(line))
        print(json.dumps({"cpu": time.process_time() - cpu, "wall": time.perf_counter() - wall}), flush=True)
        images.append(image)


# --- Outside: the comparison.


class Peer:
    """One worker; `error` says why there is none."""

    def __init__(self, arguments, scene, variant, integrator, spp):
        self.name = f"{variant} {integrator}"
        self.costs = []
        self.errors = tempfile.TemporaryFile(mode="w+")
        self.process = subprocess.Popen(
            [sys.executable, __file__, "--threads", str(arguments.threads), "--worker", str(scene), variant, integrator,
             str(spp)], stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=self.errors, text=True)
        self.error = None
        if self.process.stdout.readline().strip() != "ready":
            self.error = self.last_words()

    def last_words(self):
        self.process.wait()
        self.errors.seek(0)
        lines = [line.strip() for line in self.errors if line.strip()]
        telling = [line for line in lines if "rror" in line] or lines or ["no message"]
        return f"exit code {self.process.returncode}: {telling[0][:200]}"

    def ask(self, line):
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()
        answer = self.process.stdout.readline()
        if not answer:
            sys.exit(f"{self.name} ended: {self.last_words()}")
        return answer

    def render(self, seed):
        self.costs.append(json.loads(self.ask(str(seed))))

    def images(self, folder):
        import numpy as np
        path = pathlib.Path(folder) / f"{self.name.replace(' ', '-')}.npy"
        self.ask(f"save {path}")
        return np.load(path)

    def cost(self, clock):
        return statistics.median(cost[clock] for cost in self.costs)

    def close(self):
        self.process.stdin.close()
        self.process.wait()


def run_opaline(arguments, scene, repeats, seed, *more):
    command = [arguments.opaline, "bench", "render", "--scenes", scene, "--size", str(arguments.size),
               "--repeats", str(repeats), "--seed", str(seed), "--threads", str(arguments.threads),
               "--no-savings", "--json", *more]
    done = subprocess.run(command, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, check=True)
    return json.loads(done.stdout)["scenes"][0]["points"][0]


def variance_of(images, covered):
    """Mean over covered pixels of the renders' variance, and its standard error from disjoint pairs of renders."""
    import numpy as np
    inside = images[:, covered]
    pairs = [float(((inside[i] - inside[i + 1]) ** 2).mean() / 2) for i in range(0, len(inside) - 1, 2)]
    error = statistics.stdev(pairs) / len(pairs) ** 0.5 if len(pairs) > 1 else float("nan")
    return float(np.var(inside, axis=0, ddof=1).mean()), error


def choose(arguments, folder, scene):
    """The variant and integrator of the highest efficiency on the scene."""
    import numpy as np
    covered = np.array(json.loads(scene.read_text())["reference"]["covered"], dtype=bool)
    best = None
    for variant in arguments.variants:
        for integrator in arguments.integrators:
            # Scalar variants are slow, and their figure does not depend on the samples.
            spp = 16 if variant.startswith("scalar") else arguments.peer_spp
            peer = Peer(arguments, scene, variant, integrator, spp)
            if peer.error:
                print(f"  {peer.name:<40} cannot run: {peer.error}", flush=True)
                continue
            for seed in range(1, 5):
                peer.render(seed)
            images = peer.images(folder)[..., 0].reshape(4, -1)
            mse, _ = variance_of(images, covered)
            efficiency = 1.0 / (mse * peer.cost("cpu"))
            print(f"  {peer.name:<40} MSE {mse:.3e} in {peer.cost('cpu'):.3f} s of CPU: efficiency {efficiency:.4g}",
                  flush=True)
            if best is None or efficiency > best[0]:
                best = (efficiency, variant, integrator)
            peer.close()
    if best is None:
        sys.exit("no variant of Mitsuba runs: see the errors above")
    return best[1:]


def report_agreement(name, images, reference):
    """Whether the mean of `images` is that of the reference within their noise."""
    import numpy as np
    covered = np.array(reference["covered"], dtype=bool)
    for i in range(images.shape[-1]):
        ours = np.array(reference[f"S{i}"]["mean"])[covered]
        peer = images[..., i].reshape(len(images), -1)[:, covered]
        noise = np.array(reference[f"S{i}"]["variance"])[covered] + peer.var(axis=0, ddof=1) / len(peer)
        difference = peer.mean(axis=0) - ours
        error = np.sqrt(noise.sum()) / len(ours)
        square = (difference ** 2).mean() / noise.mean()
        print(f"  {name} S{i}: mean {peer.mean():.5f}, ours {ours.mean():.5f}, difference {difference.mean():+.5f} "
              f"+- {error:.5f}; mean square difference / noise {square:.2f}", flush=True)


def compare(arguments, folder, name, variant, integrator):
    import numpy as np
    scene = pathlib.Path(folder) / f"{name}.json"
    reference = json.loads(scene.read_text())["reference"]
    covered = np.array(reference["covered"], dtype=bool)
    peer = Peer(arguments, scene, variant, integrator, arguments.peer_spp)
    if peer.error:
        sys.exit(f"{peer.name}: {peer.error}")
    ours = {error: [] for error in arguments.error}
    for r in range(arguments.rounds):
        for error in arguments.error:
            ours[error].append(run_opaline(arguments, name, 2, 100 + r, "--error", str(error), "--reference", "256"))
        peer.render(1 + r)
        print(f"  {name}: round {r + 1} of {arguments.rounds}", file=sys.stderr, flush=True)
    images = peer.images(folder)
    report_agreement(name, images, reference)
    peer_mse, peer_error = variance_of(images[..., 0].reshape(arguments.rounds, -1), covered)
    row = {"scene": name, "peer": peer.name, "peer_spp": arguments.peer_spp, "peer_mse": peer_mse,
           "peer_mse_se": peer_error, "peer_cpu_s": peer.cost("cpu"), "peer_wall_s": peer.cost("wall"),
           "wanted": WANTED[name]}
    peer.close()
    rows = []
    for wanted, points in ours.items():
        mses = [point["mse"]["S0"] for point in points]
        mse = statistics.mean(mses)
        cpu = statistics.median(point["cpu_s"] for point in points)
        wall = statistics.median(point["wall_s"] for point in points)
        spread = statistics.stdev(mses) / len(mses) ** 0.5 if len(mses) > 1 else float("nan")
        rows.append({**row, "error": wanted, "paths": statistics.mean(point["samples"] for point in points), "mse": mse,
                     "mse_se": spread, "cpu_s": cpu, "wall_s": wall,
                     "ratio_cpu": peer_mse * row["peer_cpu_s"] / (mse * cpu),
                     "ratio_wall": peer_mse * row["peer_wall_s"] / (mse * wall)})
    return rows


def print_table(arguments, rows):
    print(f"\nS0, {arguments.size} x {arguments.size}, {arguments.threads} threads, medians; ratio = time of Mitsuba / "
          "time of opaline at equal error\n")
    columns = ["scene", "error asked", "paths", "MSE", "CPU s", "wall s", "Mitsuba samples", "MSE", "CPU s", "wall s",
               "ratio (CPU)", "ratio (wall)", "wanted"]
    print("| " + " | ".join(columns) + " |\n|---|" + "---:|" * (len(columns) - 1))
    for r in rows:
        cells = [r["scene"], f"{r['error']}", f"{r['paths']:.0f}", f"{r['mse']:.2e} +- {r['mse_se']:.0e}",
                 f"{r['cpu_s']:.3f}", f"{r['wall_s']:.3f}", f"{r['peer_spp']}",
                 f"{r['peer_mse']:.2e} +- {r['peer_mse_se']:.0e}", f"{r['peer_cpu_s']:.3f}",
                 f"{r['peer_wall_s']:.3f}", f"{r['ratio_cpu']:.2f}", f"{r['ratio_wall']:.2f}", f"{r['wanted']:.0f}"]
        print("| " + " | ".join(cells) + " |")


def main():
    arguments = parse_arguments()
    library = newest_llvm()
    if library:
        os.environ.setdefault("DRJIT_LIBLLVM_PATH", library)
    if arguments.worker:
        work(arguments)
        return
    # Threads that wait must not count as work.
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")
    with tempfile.TemporaryDirectory() as folder:
        print(f"scenes and references of {arguments.reference_spp} samples", flush=True)
        for name in SCENES:
            run_opaline(arguments, name, 1, 1, "--spp", "4", "--reference", str(arguments.reference_spp), "--export",
                        folder)
        print(f"Mitsuba on the scene '{SCENES[0]}', {arguments.threads} threads", flush=True)
        variant, integrator = choose(arguments, folder, pathlib.Path(folder) / f"{SCENES[0]}.json")
        print(f"{variant} {integrator} against opaline, {arguments.rounds} rounds", flush=True)
        rows = []
        for name in SCENES:
            rows += compare(arguments, folder, name, variant, integrator)
        if arguments.stokes:
            print("S1 and S2 (not the same quantity, see --help)", flush=True)
            peer = Peer(arguments, pathlib.Path(folder) / "uniform.json", "llvm_ad_mono_polarized", "stokes", 1024)
            if peer.error:
                print(f"  {peer.name}: {peer.error}")
            else:
                for r in range(arguments.rounds):
                    peer.render(1 + r)
                scene = json.loads((pathlib.Path(folder) / "uniform.json").read_text())
                report_agreement("uniform", peer.images(folder), scene["reference"])
                peer.close()
    print_table(arguments, rows)
    if arguments.json:
        pathlib.Path(arguments.json).write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
