#!/usr/bin/env bash
# The way from scenes to a report: train, interrupt, resume, eval, predict, report, and what is refused on the way.
set -euo pipefail
opaline=$1
make_scenes=$2
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT

die() { echo "$*" >&2; exit 1; }
expect() {  # expect CODE COMMAND...
  local wanted=$1 got=0
  shift
  "$@" >"$folder/out" 2>"$folder/err" || got=$?
  if [[ $got -ne $wanted ]]; then
    cat "$folder/out" "$folder/err" >&2
    die "exit $got, expected $wanted: $*"
  fi
}
says() {  # says FILE TEXT
  grep -qF -- "$2" "$folder/$1" || { cat "$folder/$1" >&2; die "no '$2' in $1"; }
}
# same RUN: weights, moments and log are those of the run that never stopped.
same() {
  python3 - "$folder/whole" "$1" <<'PYTHON'
import json, os, sys
def record(run):
    lines = []
    for line in open(f"{run}/metrics.jsonl"):
        event = json.loads(line)
        del event["wall"]
        lines.append(event)
    return lines
def newest(run):
    return max(os.listdir(f"{run}/checkpoints"), key=lambda name: int(name.split("-")[1]))
a, b = sys.argv[1:]
assert newest(a) == newest(b), (newest(a), newest(b))
files = sorted(os.listdir(f"{a}/checkpoints/{newest(a)}"))
assert len(files) == 8 and files == sorted(os.listdir(f"{b}/checkpoints/{newest(b)}")), files
for name in files:
    x, y = (open(f"{run}/checkpoints/{newest(run)}/{name}", "rb").read() for run in (a, b))
    assert x == y, f"{name} differs"
assert record(a) == record(b), "the logs differ"
PYTHON
}
# wait_for RUN STEP: until the log has that step, or the process has ended.
wait_for() {
  for _ in $(seq 1 1200); do
    if grep -qF "\"step\":$2," "$1/metrics.jsonl" 2>/dev/null; then return; fi
    if ! kill -0 "$pid" 2>/dev/null; then cat "$folder/log" >&2; die "the run ended before step $2"; fi
    sleep 0.05
  done
  die "step $2 did not come within a minute"
}

"$make_scenes" "$folder/data" 20 3 32
cat >"$folder/tiny.toml" <<TOML
[data]
path = "$folder/data"
[model]
image_size = 32
width = 4
[train]
batch = 4
micro_batch = 4
eval_scenes = 2
log_every = 1
keep = 3
[stage1]
epochs = 8
[stage2]
epochs = 6
TOML
train=("$opaline" train "$folder/tiny.toml")

# A run without a stop. Without --run, the folder has the config's name and a number.
expect 0 "${train[@]}" --run "$folder/whole"
says out "run folder: $folder/whole"
says err "memory: about"
says err "micro_batch = 4"
[[ -d "$folder/whole/checkpoints/step-70" ]] || die "no checkpoint of the last step"
(cd "$folder" && expect 0 "${train[@]}" --set stage1.epochs=1 --set stage2.epochs=0 &&
  expect 0 "${train[@]}" --set stage1.epochs=1 --set stage2.epochs=0)
[[ -f "$folder/runs/tiny-1/config.toml" && -f "$folder/runs/tiny-2/config.toml" ]] || die "no runs/tiny-2"

# Interrupted in both stages, each time resumed: the same bits.
"${train[@]}" --run "$folder/stopped" >"$folder/log" 2>&1 &
pid=$!
wait_for "$folder/stopped" 7
expect 1 "$opaline" resume "$folder/stopped"
says err "process $pid is training in this run folder"
kill -INT "$pid"
code=0; wait "$pid" || code=$?
[[ $code -eq 130 ]] || { cat "$folder/log"; die "exit $code after SIGINT, expected 130"; }
grep -qF "opaline resume $folder/stopped goes on" "$folder/log" || die "does not say how to go on"
step=$(sed -n 's/^interrupted after step \([0-9]*\): saved.*/\1/p' "$folder/log")
[[ -f "$folder/stopped/checkpoints/step-$step/state.json" ]] || die "step '$step' was not saved"
"$opaline" resume "$folder/stopped" >"$folder/log" 2>&1 &
pid=$!
wait_for "$folder/stopped" 47
kill -TERM "$pid"
code=0; wait "$pid" || code=$?
[[ $code -eq 143 ]] || { cat "$folder/log"; die "exit $code after SIGTERM, expected 143"; }
expect 2 "${train[@]}" --run "$folder/stopped"
says err "opaline resume $folder/stopped"
# The algorithms of its convolutions are kept with it; others would be another run.
grep -qF '"numerics": "balanced"' "$folder/stopped/convolutions.json" || die "has no plan of convolutions"
expect 2 "$opaline" resume "$folder/stopped" --set train.numerics=strict
expect 0 "$opaline" resume "$folder/stopped" --set train.threads=1 --set data.threads=2
# The state holds the config, threads and all; it is put back for the comparison.
expect 0 "$opaline" resume "$folder/stopped" --from "$folder/stopped/checkpoints/step-65" --set train.threads=0 \
  --set data.threads=1
same "$folder/stopped"

# Killed at some moments: resumed from what is whole.
"${train[@]}" --run "$folder/killed" >"$folder/log" 2>&1 &
pid=$!
for step in 6 23 44 58; do
  wait_for "$folder/killed" $step
  kill -KILL "$pid"
  wait "$pid" || true
  "$opaline" resume "$folder/killed" >"$folder/log" 2>&1 &
  pid=$!
done
wait "$pid" || { cat "$folder/log"; die "the killed run cannot be resumed"; }
same "$folder/killed"

# Killed in a checkpoint: the system ends the process at the first byte of a file over the limit. With the signal
# ignored the write fails, as on a full disk. Either way the checkpoints before it are whole and the run goes on.
cp -r "$folder/whole" "$folder/torn"
largest=$(stat -c %s "$folder"/whole/checkpoints/step-70/optimizer.safetensors)
for kib in 1 40 $((largest / 2048)) $((largest / 1024)); do
  code=0
  rm -rf "$folder/torn/checkpoints/step-70"
  (ulimit -c 0; ulimit -f $kib; "$opaline" resume "$folder/torn" --from "$folder/torn/checkpoints/step-65") \
    >"$folder/log" 2>&1 || code=$?
  [[ $code -ge 1 ]] || die "a file limit of $kib KiB was not met"
  expect 0 "$opaline" eval "$folder/torn" --data "$folder/data" --max-scenes 1
  if grep -qF "passed over" "$folder/err"; then die "a checkpoint is torn"; fi
done
code=0
(trap '' XFSZ; ulimit -f 40; exec "$opaline" resume "$folder/torn" --from "$folder/torn/checkpoints/step-65") \
  >"$folder/log" 2>&1 || code=$?
[[ $code -eq 1 ]] || { cat "$folder/log"; die "exit $code after a short write, expected 1"; }
grep -qF "File too large" "$folder/log" || { cat "$folder/log"; die "the short write is not told"; }
expect 0 "$opaline" resume "$folder/torn" --from "$folder/torn/checkpoints/step-65"
same "$folder/torn"

# A flipped bit in the newest checkpoint: the one before it is taken, with a warning.
cp -r "$folder/whole" "$folder/flipped"
printf '\xff' | dd of="$folder/flipped/checkpoints/step-70/sss.safetensors" bs=1 seek=9000 conv=notrunc status=none
expect 0 "$opaline" resume "$folder/flipped"
says err "step-70 is passed over"
same "$folder/flipped"
for checkpoint in "$folder"/flipped/checkpoints/*; do truncate -s 1000 "$checkpoint/normal.safetensors"; done
expect 1 "$opaline" resume "$folder/flipped"
says err "none of the 3 checkpoints can be read"
expect 1 "$opaline" eval "$folder/flipped" --data "$folder/data"
says err "normal.safetensors"

# A changed config or data set.
expect 2 "$opaline" resume "$folder/whole" --set train.seed=5
says err "train.seed: 1 -> 5"
"$make_scenes" "$folder/other" 24 3 32
expect 2 "$opaline" resume "$folder/whole" --set data.path="$folder/other"
says err "data set:"
expect 2 "$opaline" resume "$folder"
says err "is not a run folder"

# Evaluation.
expect 0 "$opaline" eval "$folder/whole" --data "$folder/data" --json "$folder/eval.json"
says out "training mean"
says out "angular_degrees"
python3 - "$folder/eval.json" <<'PYTHON'
import json, sys
e = json.load(open(sys.argv[1]))
assert list(e) == ["n", "release", "angular_degrees", "depth_aligned", "ci95", "mean_predictor"], list(e)
columns = ["normal", "depth", "sigma_t", "albedo", "g"]
assert e["n"] == 3 and list(e["release"]) == columns and list(e["mean_predictor"]["release"]) == columns
for group in (e, e["mean_predictor"]):
    assert all(group["release"][c] > 0 for c in columns) and 0 < group["angular_degrees"] < 180
for value, (low, high) in [(e["release"][c], e["ci95"]["release"][c]) for c in columns] + [
        (e["angular_degrees"], e["ci95"]["angular_degrees"])]:
    assert low <= value <= high, (low, value, high)
PYTHON
expect 0 "$opaline" eval "$folder/whole" --data "$folder/data" --sensor --json "$folder/sensor.json"
says out "with the errors of a sensor"
python3 - "$folder/eval.json" "$folder/sensor.json" <<'PYTHON'
import json, sys
clean, both = (json.load(open(path)) for path in sys.argv[1:])
sensor = both.pop("sensor")
assert both == clean, "the clean part must not change"
assert list(sensor) == list(clean) and sensor["n"] == clean["n"]
assert sensor["release"] != clean["release"] and sensor["mean_predictor"] == clean["mean_predictor"]
PYTHON
expect 2 "$opaline" eval "$folder/whole"
says err "--data"
expect 1 "$opaline" eval "$folder/whole" --data "$folder/nowhere"
says err "nowhere"

# Prediction on the test scenes, on one of them, and on a capture.
expect 0 "$opaline" predict "$folder/whole" "$folder/data" --out "$folder/predicted"
for name in input.png normal.png depth.png prediction.exr prediction.json; do
  [[ -s "$folder/predicted/test-2/$name" ]] || die "no test-2/$name"
done
python3 - "$folder/predicted/test-2/prediction.json" <<'PYTHON'
import json, sys
p = json.load(open(sys.argv[1]))
assert len(p["sss"]["sigma_t"]) == 3 and len(p["illumination"]["sh"]) == 3 and len(p["illumination"]["sh"][0]) == 9
assert p["width"] == p["height"] == 32 and "exposure" in p["notes"], p
PYTHON
expect 0 "$opaline" predict "$folder/whole" "$folder/data/scenes/000020.exr" --out "$folder/one" --only normal
[[ -s "$folder/one/test-0/normal.png" && ! -e "$folder/one/test-0/depth.png" ]] || die "--only normal wrote depth"
cmp "$folder/one/test-0/normal.png" "$folder/predicted/test-0/normal.png" || die "--only changes the result"
expect 2 "$opaline" predict "$folder/whole" "$folder/data" --out "$folder/bad" --only normals
says err "normals"
expect 2 "$opaline" predict "$folder/whole" "$folder/missing" --out "$folder/bad"
says err "missing"
expect 2 "$opaline" predict "$folder/whole" "$folder/data" "$folder/data" --out "$folder/bad"
says err "two inputs are named"

python3 - "$folder/capture" <<'PYTHON'
import os, struct, sys, zlib
def png(path, w, h, pixel):
    raw = b"".join(b"\0" + b"".join(bytes(pixel(x, y)) for x in range(w)) for y in range(h))
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
    open(path, "wb").write(b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", struct.pack(">IIBBBBB", w, h, 8, 2, 0, 0, 0)) +
                           chunk(b"IDAT", zlib.compress(raw)) + chunk(b"IEND", b""))
root = sys.argv[1]
os.mkdir(root)
inside = lambda x, y: (x - 25) ** 2 + (y - 20) ** 2 < 225
for i, angle in enumerate((0, 45, 90, 135)):
    png(f"{root}/p{angle}.png", 50, 40, lambda x, y: (90 + 5 * i, 80, 2 * x) if inside(x, y) else (3, 3, 3))
png(f"{root}/mask.png", 50, 40, lambda x, y: (255,) * 3 if inside(x, y) else (0,) * 3)
PYTHON
expect 0 "$opaline" predict "$folder/whole" "$folder/capture" --out "$folder/captured"
[[ -s "$folder/captured/capture/normal.png" ]] || die "no prediction of the capture"
expect 0 "$opaline" predict "$folder/whole" "$folder/capture" --out "$folder/captured" --size 0
cp -r "$folder/capture" "$folder/no45" && rm "$folder/no45/p45.png"
expect 1 "$opaline" predict "$folder/whole" "$folder/no45" --out "$folder/bad"
says err "p45.png"
cp -r "$folder/capture" "$folder/short" && truncate -s 200 "$folder/short/p90.png"
expect 1 "$opaline" predict "$folder/whole" "$folder/short" --out "$folder/bad"
says err "p90.png"
cp -r "$folder/capture" "$folder/npy" && printf '\x93NUMPY\x01\x00' >"$folder/npy/s0.npy"
cp "$folder/npy/s0.npy" "$folder/npy/s1.npy" && cp "$folder/npy/s0.npy" "$folder/npy/s2.npy"
expect 1 "$opaline" predict "$folder/whole" "$folder/npy" --out "$folder/bad"
says err "s0.npy"
[[ ! -e "$folder/bad" ]] || die "a refused prediction wrote $(ls "$folder/bad")"

# The report: one file with everything in it.
expect 0 "$opaline" report "$folder/whole"
says out "report.html"
grep -q "data:image/png;base64" "$folder/whole/report.html" || die "no pictures in the report"
if grep -qE "(src|href)=.(http|/|\.)" "$folder/whole/report.html"; then die "the report needs other files"; fi
expect 0 "$opaline" report "$folder/whole" --data "$folder/other" --scenes 2
expect 2 "$opaline" report "$folder"
says err "is not a run folder"

# Configs and data that cannot be.
printf '[model]\nwidht = 16\n[train]\nbatch = "many"\n' >"$folder/wrong.toml"
expect 2 "$opaline" train "$folder/wrong.toml" --run "$folder/bad"
says err "wrong.toml:2: unknown key 'model.widht'; did you mean 'model.width'?"
says err "wrong.toml:4: 'train.batch' must be an integer"
expect 2 "${train[@]}" --run "$folder/bad" --set model.image_size=40
says err "40 is not divisible by 16"
expect 2 "${train[@]}" --run "$folder/bad" --set train.bach=8
says err "did you mean 'train.batch'?"
expect 2 "${train[@]}" --run "$folder/bad" --set data.path=
says err "data.path is not set"
expect 2 "$opaline" train "$folder/none.toml" --run "$folder/bad"
says err "none.toml"
expect 1 "${train[@]}" --run "$folder/bad" --set data.path="$folder/nowhere"
says err "nowhere"
[[ ! -e "$folder/bad" ]] || die "a refused run left $(ls "$folder/bad")"
"$make_scenes" "$folder/forty" 8 1 40
expect 1 "${train[@]}" --run "$folder/bad" --set data.path="$folder/forty"
says err "40 x 40"
rm -r "$folder/bad"

# A damaged scene stops the run by its name; repaired, the run goes on.
cp -r "$folder/data" "$folder/damaged"
truncate -s 600 "$folder/damaged/scenes/000013.exr"
expect 1 "${train[@]}" --run "$folder/on-damaged" --set data.path="$folder/damaged"
says err "000013.exr"
cp "$folder/data/scenes/000013.exr" "$folder/damaged/scenes/"
printf '\xff' | dd of="$folder/damaged/scenes/000013.exr" bs=1 seek=700 conv=notrunc status=none
expect 1 "${train[@]}" --run "$folder/on-damaged" --set data.path="$folder/damaged"
says err "000013.exr"
cp "$folder/data/scenes/000013.exr" "$folder/damaged/scenes/"
expect 0 "${train[@]}" --run "$folder/on-damaged" --set data.path="$folder/damaged" --set stage1.epochs=1 \
  --set stage2.epochs=0
echo ok
