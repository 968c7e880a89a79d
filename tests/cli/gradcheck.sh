#!/usr/bin/env bash
# `opaline gradcheck`: the table, the exit codes, the suggestion for an unknown name, a config's losses.
set -euo pipefail
opaline=$1
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT

fail() { echo "$*" >&2; exit 1; }
expect() { grep -q -- "$2" "$1" || { cat "$1" >&2; fail "expected '$2'"; }; }

"$opaline" gradcheck conv2d >"$folder/conv2d.txt"
expect "$folder/conv2d.txt" '^case .*inputs .*gradient .*limit .*verdict'
expect "$folder/conv2d.txt" '^conv2d/k3_s2_p1 .*x 2x7x6x5, weight 9x5x3x3 .* ok$'
expect "$folder/conv2d.txt" ' 0 failed$'
if grep -q linear "$folder/conv2d.txt"; then fail "one operation was asked for"; fi

"$opaline" gradcheck linear/bias --verbose >"$folder/case.txt"
expect "$folder/case.txt" '^1 checked, 0 failed$'
expect "$folder/case.txt" '^    weight .*error'

"$opaline" gradcheck illumination >"$folder/network.txt"
expect "$folder/network.txt" '^illumination train .* ok$'
expect "$folder/network.txt" '^illumination eval .* ok$'

# Stage 1 alone, every kind of loss that it can have.
cat >"$folder/run.toml" <<'TOML'
[model]
variant = "release"
[train]
batch = 8
micro_batch = 8
[stage1]
freeze = ["depth"]
[stage2]
epochs = 0
[loss]
normal = { weight = 10.0, kind = "cosine" }
depth = { weight = 1.0, kind = "l2" }
TOML
"$opaline" gradcheck "$folder/run.toml" >"$folder/config.txt"
expect "$folder/config.txt" '^run.toml stage 1 .* ok$'
expect "$folder/config.txt" '^1 checked, 0 failed$'

status=0
"$opaline" gradcheck conv3d 2>"$folder/error.txt" || status=$?
[[ $status -eq 2 ]] || fail "an unknown name gave exit code $status"
expect "$folder/error.txt" "did you mean 'conv2d'"

status=0
"$opaline" gradcheck "$folder/none.toml" 2>"$folder/error.txt" || status=$?
[[ $status -eq 2 ]] || fail "a missing config gave exit code $status"
expect "$folder/error.txt" 'none.toml'
