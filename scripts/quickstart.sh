#!/usr/bin/env bash
# From an empty machine to a prediction: installs what is missing, builds, renders a small data set, trains both
# stages, evaluates, predicts on a capture and writes a report. At most ten minutes on two cores, downloads aside.
#   scripts/quickstart.sh [FOLDER]     results go to FOLDER (default: quickstart/)
set -euo pipefail
cd "$(dirname "$0")/.."
out=${1:-quickstart}
opaline=build/release/opaline
config=configs/quick.toml

step() { printf '\n== %s  (%d s)\n' "$*" "$SECONDS"; }

./scripts/setup.sh
SECONDS=0  # downloads aside

step "build"
cmake --preset release >/dev/null
cmake --build --preset release --target opaline

step "render"
"$opaline" render "$config" --out "$out/data"

step "train"
if [[ -d "$out/run/checkpoints" ]]; then
  "$opaline" resume "$out/run"
else
  "$opaline" train "$config" --set data.path="$out/data" --run "$out/run"
fi

step "evaluate"
"$opaline" eval "$out/run" --data "$out/data" --json "$out/eval.json"

step "predict"
# The authors' captures where they are at hand, otherwise a held-out scene.
captures=(../shared/real_captures/*/)
if [[ -d "${captures[0]}" ]]; then
  "$opaline" predict "$out/run" "${captures[@]}" --out "$out/predictions"
else
  last=$(ls "$out"/data/scenes/*.exr | tail -n 1)
  "$opaline" predict "$out/run" "$last" --out "$out/predictions"
fi

step "report"
"$opaline" report "$out/run"

step "done"
echo "report:      $out/run/report.html"
echo "predictions: $out/predictions"
