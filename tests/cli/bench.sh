#!/usr/bin/env bash
# `opaline bench`: tables, JSON objects, the chart, what is exported, bad usage.
set -euo pipefail
opaline=$1
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT

fail() { echo "$*" >&2; exit 1; }
expect() { grep -q -- "$2" "$1" || { cat "$1" >&2; fail "expected '$2'"; }; }

"$opaline" bench render --size 16 --spp 4,16 --error 0.5 --repeats 2 --reference 64 --plot "$folder/chart.svg" --export "$folder/scenes" \
  >"$folder/table.txt" 2>"$folder/progress.txt"
for scene in uniform flash room dense clear contrast contrast-uniform; do expect "$folder/table.txt" "^$scene: "; done
expect "$folder/table.txt" 'samples .*MSE S0 .*MSE S1 .*MSE S2 .*MSE S0 clipped'
expect "$folder/table.txt" 'slope of log MSE over log CPU time'
for saving in 'guide' 'counts by part' 'counts by pixel' 'shared paths' 'bounded queries' 'even samples'; do
  expect "$folder/table.txt" "$saving on / off at error 0.5: efficiency  S0 x"
done
expect "$folder/table.txt" '^room of contrast 1e5 over uniform light'
expect "$folder/chart.svg" 'slope -1'
python3 - "$folder" <<'PYTHON'
import json, pathlib, sys
import xml.etree.ElementTree
folder = pathlib.Path(sys.argv[1])
xml.etree.ElementTree.parse(folder / "chart.svg")
header = (folder / "scenes" / "body.ply").read_bytes().split(b"end_header\n")
vertices, faces = (int(line.split()[-1]) for line in header[0].decode().splitlines() if line.startswith("element"))
assert len(header[1]) == 12 * vertices + 13 * faces, (len(header[1]), vertices, faces)
for name in ("uniform", "flash"):
    scene = json.loads((folder / "scenes" / f"{name}.json").read_text())
    reference = scene["reference"]
    assert len(reference["S0"]["mean"]) == len(reference["S2"]["variance"]) == len(reference["covered"]) == 256
    assert (scene["flash"]["radiance"] > 0) == (name == "flash") == (scene["environment_radiance"] == 0), scene
PYTHON

# Random numbers are keyed: but for the times two runs are the same.
for run in 1 2; do
  "$opaline" bench render --size 16 --spp 4 --repeats 2 --scenes flash --no-savings --json >"$folder/$run.json" 2>/dev/null
done
python3 - "$folder/1.json" "$folder/2.json" <<'PYTHON'
import json, sys
one, two = (json.load(open(path)) for path in sys.argv[1:])
points = [run["scenes"][0]["points"][0] for run in (one, two)]
assert points[0]["mse"] == points[1]["mse"], points
assert all(points[0]["mse"][name] > 0 for name in ("S0", "S1", "S2")), points
assert points[0]["cpu_s"] > 0 and points[0]["efficiency"]["S0"] > 0, points
PYTHON

status=0
"$opaline" bench render --scenes nowhere 2>"$folder/error.txt" || status=$?
[[ $status -eq 2 ]] || fail "an unknown scene gave exit code $status"
expect "$folder/error.txt" "no scene is called 'nowhere'; there are uniform"

printf '[render]\ntrain = 4\nsize = 24\nspp = 4\nphotons = 500\nfamilies = ["harmonics"]\n' > "$folder/noise.toml"
"$opaline" bench noise "$folder/noise.toml" --scenes 2 > "$folder/noise.txt"
expect "$folder/noise.txt" 'root mean square over scenes: S0 .* %, DoP 0\.'
for spp in 4 64; do
  "$opaline" bench noise "$folder/noise.toml" --scenes 2 --json --set render.spp=$spp > "$folder/noise$spp.json"
done
python3 - "$folder" <<'PYTHON'
import json, pathlib, sys
few, many = (json.loads((pathlib.Path(sys.argv[1]) / f"noise{spp}.json").read_text()) for spp in (4, 64))
assert len(few["scenes"]) == 2 and few["scenes"][0]["pixels"] > 0, few
assert 0 < many["error"] < 0.7 * few["error"], (few["error"], many["error"])
PYTHON

"$opaline" bench stress --export "$folder/stress" > "$folder/stress.txt"
expect "$folder/stress.txt" '^| conv2d .*|'
"$opaline" bench stress --numerics strict --json > "$folder/stress.json"
python3 - "$folder" <<'PYTHON'
import json, pathlib, struct, sys
folder = pathlib.Path(sys.argv[1])
report = json.loads((folder / "stress.json").read_text())
assert report["numerics"] == "strict" and 0 < report["operations"]["conv2d"]["forward"] < 1e-5, report
assert {path.stem for path in (folder / "stress").iterdir()} == set(report["operations"]), report
data = (folder / "stress" / "relu.safetensors").read_bytes()
header = json.loads(data[8:8 + struct.unpack("<Q", data[:8])[0]])
for name in ("x", "cotangent", "expected.y", "scale.y", "expected.grad.x"):
    assert f"relu/plain@huge/{name}" in header, name
assert json.loads(header["__metadata__"]["relu/plain@huge"])["ours"] == ["0", "0"], header["__metadata__"]
PYTHON
status=0
"$opaline" bench stress --numerics sloppy 2>"$folder/error.txt" || status=$?
[[ $status -eq 2 ]] || fail "unknown numerics gave exit code $status"

# Convolutions and networks: every algorithm, its error, and errors within their bounds.
"$opaline" bench conv --batch 1 --size 16 --in 32 --out 32 --repeats 1 > "$folder/conv.txt"
for way in direct 'F(2x2)' 'F(4x4)' 'F(6x6)'; do expect "$folder/conv.txt" "$way"; done
expect "$folder/conv.txt" 'weight gradient .* strict'
"$opaline" bench layers --net normal --size 32 --width 16 --repeats 1 --plot "$folder/roof.svg" > "$folder/layers.txt"
expect "$folder/layers.txt" 'inc.double_conv.0.weight'
expect "$folder/layers.txt" '^strict: .* worst error 0\.'
for series in strict balanced fast roof; do expect "$folder/roof.svg" ">$series</text>"; done
"$opaline" bench step --net cascade --forward --size 32 --width 8 --repeats 1 --numerics fast --json > "$folder/step.json"
expect "$folder/step.json" '"beyond_parameters_bytes":[1-9]'

# Whole networks: a row of every size, number of threads and numerics; errors do not depend on threads.
"$opaline" bench net --net normal --size 32 48 --threads 1 2 --width 8 --repeats 1 --plot "$folder/net.svg" > "$folder/net.txt"
expect "$folder/net.txt" '^| 48 | 2 | balanced | .* % |'
for series in 'fast x2' 'strict: grad'; do expect "$folder/net.svg" "$series"; done
"$opaline" bench net --net sss --size 32 --threads 1 2 --batch 8 --width 8 --repeats 1 --json > "$folder/net.json"
# Its weights and inputs from files: the decoder's, which are small.
python3 - "$folder" <<'PYTHON'
import array, json, math, pathlib, struct, sys
folder = pathlib.Path(sys.argv[1])
def save(name, tensors):
    header, data = {}, b""
    for key, (shape, values) in tensors.items():
        kind = "F32" if isinstance(values[0], float) else "I64"
        blob = array.array("f" if kind == "F32" else "q", values).tobytes()
        header[key] = {"dtype": kind, "shape": shape, "data_offsets": [len(data), len(data) + len(blob)]}
        data += blob
    text = json.dumps(header).encode()
    (folder / name).write_bytes(struct.pack("<Q", len(text)) + text + data)
def wave(*shape): return shape, [math.sin(1.0 + 1.3 * i) for i in range(math.prod(shape))]
weights, channels = {}, [27, 8, 4, 2, 1, 1]
for i, (n, m) in enumerate(zip(channels, channels[1:])):
    weights[f"model.{3 * i}.weight"] = wave(n, m, 4, 4)
    norm = f"model.{3 * i + 1}."
    weights |= {norm + "weight": wave(m), norm + "bias": wave(m), norm + "running_mean": wave(m),
                norm + "running_var": ([m], [1.0] * m), norm + "num_batches_tracked": ([], [6])}
save("weights.safetensors", weights)
save("input.safetensors", {"x": wave(5, 27), "cotangent": wave(5, 1, 32, 32)})
del weights["model.1.bias"]
save("lacking.safetensors", weights)
PYTHON
decoder=(bench net --net illumination_decoder --size 32 --width 4 --repeats 1 --input "$folder/input.safetensors" --json)
"$opaline" "${decoder[@]}" --weights "$folder/weights.safetensors" > "$folder/decoder.json"
python3 - "$folder" <<'PYTHON'
import json, pathlib, sys
net, decoder = (json.loads((pathlib.Path(sys.argv[1]) / f"{name}.json").read_text()) for name in ("net", "decoder"))
assert [row["numerics"] for row in net["rows"]] == 2 * ["strict", "balanced", "fast"], net
errors = ("result_error", "parameter_gradient_error", "input_gradient_error")
for one, two in zip(net["rows"][:3], net["rows"][3:]):
    assert (one["threads"], two["threads"]) == (1, 2) and all(one[e] == two[e] for e in errors), (one, two)
# A rectifier that flips weighs far more in gradients than rounding.
limits = {"strict": 1e-5, "balanced": 1e-4, "fast": 1e-3}
for row in net["rows"] + decoder["rows"]:
    assert 0 < row["result_error"] < limits[row["numerics"]] and all(0 < row[e] < 0.1 for e in errors[1:]), row
    assert 0 < row["forward_seconds"] and 0 < row["step_seconds"], row
    assert all(row[rate] > 0 for rate in ("gflops", "peak_share", "gigabytes_per_second", "copy_share")), row
assert decoder["rows"][0]["pixels"] == 5 * 32 * 32, decoder  # the file's batch
PYTHON
for weights in nowhere lacking; do
  status=0
  "$opaline" "${decoder[@]}" --weights "$folder/$weights.safetensors" >/dev/null 2>"$folder/error.txt" || status=$?
  [[ $status -eq 1 ]] || fail "bench net with weights '$weights' gave exit code $status"
  expect "$folder/error.txt" "$weights.safetensors"
done
expect "$folder/error.txt" 'missing: model.1.bias (8)'

# Skipping: less work, less memory, fewer bytes; nothing is gained at 100 %.
"$opaline" bench skip --net normal --size 64 --width 8 --batch 2 --repeats 1 --mask 0.05 1 --plot "$folder/skip.svg" > "$folder/skip.txt"
expect "$folder/skip.txt" '| 100 % | 100.0 % |'
"$opaline" bench skip --net stage1 --size 64 --width 8 --batch 2 --repeats 1 --mask 0.05 1 --json > "$folder/skip.json"
"$opaline" bench step --net normal --size 64 --width 8 --repeats 1 --mask 0.05 --skip --json > "$folder/part.json"
"$opaline" bench step --net normal --size 64 --width 8 --repeats 1 --json > "$folder/whole.json"
python3 - "$folder" <<'PYTHON'
import json, pathlib, sys
import xml.etree.ElementTree
folder = pathlib.Path(sys.argv[1])
xml.etree.ElementTree.parse(folder / "skip.svg")
part, whole = json.loads((folder / "skip.json").read_text())["rows"]
assert part["tiles"] == 4 / 16 and whole["tiles"] == 1.0, (part, whole)  # a disc in the middle meets four tiles
assert part["peak_beyond"] < part["dense_peak_beyond"] and part["moved"] < part["dense_moved"], part
assert whole["moved"] > 0.95 * whole["dense_moved"], whole
sizes = [json.loads((folder / name).read_text())["peak_bytes"] for name in ("part.json", "whole.json")]
assert sizes[0] < sizes[1], sizes
PYTHON
if "$opaline" bench skip --net cascade >"$folder/skip.txt" 2>&1; then fail "bench skip trained a cascade"; fi
expect "$folder/skip.txt" '--forward'

# Runs: groups of seeds, by their logs.
for name in a1 a2 b1; do
  mkdir -p "$folder/$name"
  skip=none
  [[ $name == b* ]] && skip=support
  printf '[model]\nskip = "%s"\n[train]\nseed = %s\n' "$skip" "${name:1}" > "$folder/$name/config.toml"
  for epoch in 0 1; do
    error=$((10 * (2 - epoch) + ${name:1}))
    printf '{"event":"epoch","stage":1,"epoch":%s,"wall":{"seconds":2.5}}\n' "$epoch"
    printf '{"event":"eval","stage":1,"epoch":%s,"release":{"g":null},"angular_degrees":%s}\n' "$epoch" "$error"
  done > "$folder/$name/metrics.jsonl"
done
"$opaline" bench runs "$folder"/{a1,a2,b1} --plot "$folder/runs.svg" > "$folder/runs.txt"
expect "$folder/runs.txt" '^| skip = none | 2 | 5 | .* 11.5 ± 0.71 |'
expect "$folder/runs.txt" '^| skip = support | 1 | 5 | .* 11 |'
"$opaline" bench runs "$folder"/{a1,a2,b1} --json > "$folder/runs.json"
python3 - "$folder" <<'PYTHON'
import json, pathlib, sys
import xml.etree.ElementTree
folder = pathlib.Path(sys.argv[1])
xml.etree.ElementTree.parse(folder / "runs.svg")
first, second = json.loads((folder / "runs.json").read_text())
assert [e["seconds"] for e in first["evaluations"]] == [2.5, 5.0], first
assert [e["angular_degrees"]["mean"] for e in second["evaluations"]] == [21, 11], second
PYTHON
sed -i '$d' "$folder/a2/metrics.jsonl"
if "$opaline" bench runs "$folder"/{a1,a2} >/dev/null 2>"$folder/error.txt"; then fail "bench runs took an unfinished run"; fi
expect "$folder/error.txt" 'has it ended'

# Memory: a row of each batch and way, but no training on a single vector.
"$opaline" bench memory --net stage1 --size 32 --width 8 --batch 1 2 > "$folder/memory.txt"
expect "$folder/memory.txt" '^| 2 | training | [0-9.]* | [0-9.]* | [0-9.]* | [0-9.]* | [0-9.]* |'
"$opaline" bench memory --net stage1 --size 32 --width 8 --batch 1 2 --json > "$folder/memory.json"
python3 - "$folder/memory.json" <<'PYTHON'
import json, sys
rows = json.load(open(sys.argv[1]))["rows"]
assert [(row["batch"], row["way"]) for row in rows] == [
    (1, "forward"), (2, "forward"), (2, "training"), (2, "training, checkpoints")], rows
one, two, training, checkpoints = rows
assert checkpoints["graph"] < 0.5 * training["graph"] and checkpoints["weights"] == training["weights"], rows
assert one["weights"] == two["weights"] == training["weights"] == training["gradients"] > 0, rows
assert one["gradients"] == one["moments"] == one["graph"] == 0 < one["peak_beyond"] < two["peak_beyond"], rows
assert 2 * training["weights"] <= training["moments"] < 2.5 * training["weights"] and training["graph"] > 0, rows
PYTHON

for bad in "net --net stage1" "net --net normal --weights w" "net --net normal --size 32 48 --weights w --input x" \
  "memory" "step --net cascade" "step --net normal --numerics quick" "layers" "layers --net normal --run nowhere"; do
  status=0
  [[ "$bad" == *--size* ]] || bad+=" --size 32"
  # shellcheck disable=SC2086  # words on purpose
  "$opaline" bench $bad --width 8 >/dev/null 2>"$folder/error.txt" || status=$?
  [[ $status -eq 2 ]] || fail "bench $bad gave exit code $status"
done
