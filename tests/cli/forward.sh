#!/usr/bin/env bash
# `opaline forward`: results, gradients and buffers are written under their names, and bad input is refused.
set -euo pipefail
opaline=$1
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT

# Weights of the smallest network (the decoder at size 32 and width 4), an input and a cotangent.
cat >"$folder/tensors.py" <<'PYTHON'
import array, json, math, struct, sys

def save(path, tensors):
    header, data = {}, b""
    for name, (kind, shape, values) in tensors.items():
        blob = array.array({"F32": "f", "F64": "d", "I64": "q"}[kind], values).tobytes()
        header[name] = {"dtype": kind, "shape": shape, "data_offsets": [len(data), len(data) + len(blob)]}
        data += blob
    text = json.dumps(header).encode()
    open(path, "wb").write(struct.pack("<Q", len(text)) + text + data)

def load(path):
    raw = open(path, "rb").read()
    length = struct.unpack("<Q", raw[:8])[0]
    header = json.loads(raw[8:8 + length])
    header.pop("__metadata__", None)
    result = {}
    for name, entry in header.items():
        begin, end = (8 + length + offset for offset in entry["data_offsets"])
        values = array.array({"F32": "f", "F64": "d", "I64": "q"}[entry["dtype"]], raw[begin:end])
        result[name] = (entry["dtype"], entry["shape"], list(values))
    return result

def wave(shape, phase, scale=1.0):
    return "F64", shape, [scale * math.sin(phase + 1.3 * i) for i in range(math.prod(shape))]

def weights():
    tensors, channels = {}, [27, 8, 4, 2, 1, 1]
    for i, (n, m) in enumerate(zip(channels, channels[1:])):
        conv, norm = f"model.{3 * i}.", f"model.{3 * i + 1}."
        tensors[conv + "weight"] = wave([n, m, 4, 4], i, 0.2)
        tensors[norm + "weight"] = wave([m], i + 0.5)
        tensors[norm + "bias"] = wave([m], i + 0.7, 0.1)
        tensors[norm + "running_mean"] = ("F64", [m], [0.0] * m)
        tensors[norm + "running_var"] = ("F64", [m], [1.0] * m)
        tensors[norm + "num_batches_tracked"] = ("I64", [], [6])
    return tensors
PYTHON

python3 - "$folder" <<'PYTHON'
import sys
folder = sys.argv[1]
sys.path.insert(0, folder)
from tensors import *
good = weights()
save(f"{folder}/weights.safetensors", good)
x = {"x": wave([4, 27], 0.1), "cotangent": wave([4, 1, 32, 32], 0.2)}
save(f"{folder}/input.safetensors", x)
# The same input moved a little along x[1][5], for a difference quotient.
for name, step in (("plus", 1e-5), ("minus", -1e-5)):
    moved = [value + (step if i == 27 + 5 else 0.0) for i, value in enumerate(x["x"][2])]
    save(f"{folder}/{name}.safetensors", {"x": ("F64", [4, 27], moved)})
save(f"{folder}/no_x.safetensors", {"z": wave([4, 27], 0.1)})
save(f"{folder}/nan.safetensors", good | {"model.1.bias": ("F64", [8], [float("nan")] * 8)})
del good["model.1.bias"]
good["model.9.weight"] = wave([3, 1, 4, 4], 1.0)
save(f"{folder}/wrong.safetensors", good)
PYTHON

small=(--size 32 --width 4)
run() { "$opaline" forward illumination_decoder --output "$folder/out.safetensors" "$@"; }

for input in plus minus; do
  run "${small[@]}" --weights "$folder/weights.safetensors" --input "$folder/$input.safetensors" \
    --dtype float64 --mode train
  mv "$folder/out.safetensors" "$folder/$input.out.safetensors"
done
run "${small[@]}" --weights "$folder/weights.safetensors" --input "$folder/input.safetensors" --dtype float64 \
  --mode train --grad
python3 - "$folder" <<'PYTHON'
import sys
folder = sys.argv[1]
sys.path.insert(0, folder)
from tensors import *
out, plus, minus = (load(f"{folder}/{name}.safetensors") for name in ("out", "plus.out", "minus.out"))
state = weights()
buffers = {name for name in state if "running" in name or "tracked" in name}
assert set(out) == {"y", "grad.x"} | {"buffer." + n for n in buffers} | {"grad." + n for n in set(state) - buffers}
assert set(plus) == {"y"} | {"buffer." + n for n in buffers}
for name in set(state) - buffers:
    assert out["grad." + name][:2] == state[name][:2], name
assert out["y"][:2] == ("F64", [4, 1, 32, 32]) and out["grad.x"][:2] == ("F64", [4, 27])
assert out["buffer.model.1.num_batches_tracked"] == ("I64", [], [7])
cotangent = wave([4, 1, 32, 32], 0.2)[2]
quotient = sum(c * (p - m) for c, p, m in zip(cotangent, plus["y"][2], minus["y"][2])) / 2e-5
gradient = out["grad.x"][2][27 + 5]
assert abs(quotient - gradient) <= 1e-5 * max(1.0, abs(gradient)), (quotient, gradient)
PYTHON

# Evaluation writes no buffers; float32 takes float64 weights. A config says the same as the flags.
run "${small[@]}" --weights "$folder/weights.safetensors" --input "$folder/input.safetensors"
cp "$folder/out.safetensors" "$folder/flags.safetensors"
printf '[data]\npath = "nowhere"\n[model]\nvariant = "release"\nimage_size = 32\nwidth = 4\n' >"$folder/c.toml"
run --config "$folder/c.toml" --weights "$folder/weights.safetensors" --input "$folder/input.safetensors"
cmp "$folder/out.safetensors" "$folder/flags.safetensors"
python3 - "$folder" <<'PYTHON'
import sys
folder = sys.argv[1]
sys.path.insert(0, folder)
from tensors import *
out = load(f"{folder}/out.safetensors")
assert set(out) == {"y"} and out["y"][:2] == ("F32", [4, 1, 32, 32]), out.keys()
PYTHON

# refuses CODE TEXT ARGUMENTS..: fails with that code, says TEXT, and writes nothing.
refuses() {
  local code=$1 text=$2 status=0
  shift 2
  rm -f "$folder/out.safetensors"
  run "$@" >"$folder/log" 2>&1 || status=$?
  if [[ $status -ne $code ]] || ! grep -qF -- "$text" "$folder/log" || [[ -e "$folder/out.safetensors" ]]; then
    echo "expected exit $code and '$text', got exit $status and:" >&2
    cat "$folder/log" >&2
    exit 1
  fi
}
input=(--input "$folder/input.safetensors")
weights=(--weights "$folder/weights.safetensors")
refuses 1 "missing: model.1.bias (8)" "${small[@]}" --weights "$folder/wrong.safetensors" "${input[@]}"
refuses 1 "shape: model.9.weight is 3x1x4x4, expected 2x1x4x4" "${small[@]}" \
  --weights "$folder/wrong.safetensors" "${input[@]}"
refuses 1 "not finite: model.1.bias" "${small[@]}" --weights "$folder/nan.safetensors" "${input[@]}"
refuses 1 "has no tensor 'x'" "${small[@]}" "${weights[@]}" --input "$folder/no_x.safetensors"
refuses 1 "has no tensor 'cotangent'" "${small[@]}" "${weights[@]}" --input "$folder/plus.safetensors" --grad
refuses 1 "absent.safetensors" "${small[@]}" --weights "$folder/absent.safetensors" "${input[@]}"
refuses 2 "multiple of 4" --size 32 --width 5 "${weights[@]}" "${input[@]}"
refuses 2 "--mode" "${small[@]}" "${weights[@]}" "${input[@]}" --mode both
refuses 2 "--weights" "${small[@]}" "${input[@]}"
refuses 2 "--config" --config "$folder/c.toml" "${small[@]}" "${weights[@]}" "${input[@]}"

# A forced NaN passes through.
run "${small[@]}" --weights "$folder/nan.safetensors" "${input[@]}" --force
echo ok
