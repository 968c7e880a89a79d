#!/usr/bin/env bash
# `opaline render` and `validate` from the shell: exit codes, resuming, the same bytes for any thread count.
set -euo pipefail
opaline=$1
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"

fail() { echo "FAILED: $*" >&2; exit 1; }
expect_code() {
  local expected=$1 code=0
  shift
  "$@" > out.txt 2> err.txt || code=$?
  [[ $code -eq $expected ]] || { cat out.txt err.txt >&2; fail "exit code $code instead of $expected: $*"; }
}

cat > tiny.toml <<'END'
[render]
train = 6
test = 3
size = 16
spp = 1
photons = 200
END

expect_code 0 "$opaline" render tiny.toml --out one --threads 1
grep -q "9 scenes rendered, 0 kept" out.txt || fail "counts of a fresh set: $(cat out.txt)"
expect_code 0 "$opaline" render tiny.toml --out two --threads 3
for file in one/scenes/*.exr; do
  cmp "$file" "two/scenes/${file##*/}" || fail "$file depends on the number of threads"
done
cut -d, -f1-3 one/train.jsonl > a; cut -d, -f1-3 two/train.jsonl > b
cmp a b || fail "the index depends on the number of threads"

# What is there is kept, what is gone comes back.
rm two/scenes/000002.exr
expect_code 0 "$opaline" render tiny.toml --out two
grep -q "1 scenes rendered, 8 kept" out.txt || fail "counts of a resumed set: $(cat out.txt)"
cmp one/scenes/000002.exr two/scenes/000002.exr || fail "a scene that was rendered again differs"

# A killed run goes on; an interrupted one says so in its exit code.
"$opaline" render tiny.toml --out killed --set render.train=40 --set render.spp=16 > /dev/null 2>&1 & pid=$!
for _ in $(seq 200); do
  if [[ -s killed/train.jsonl ]]; then break; fi
  sleep 0.05
done
kill -KILL $pid; wait $pid || true
expect_code 0 "$opaline" render tiny.toml --out killed --set render.train=40 --set render.spp=16
grep -qE "[1-9][0-9]* kept" out.txt || fail "a killed run lost its scenes: $(cat out.txt)"
"$opaline" render tiny.toml --out stopped --set render.train=400 --set render.spp=16 > /dev/null 2>&1 & pid=$!
for _ in $(seq 200); do
  if [[ -s stopped/train.jsonl ]]; then break; fi
  sleep 0.05
done
kill -INT $pid
code=0; wait $pid || code=$?
[[ $code -eq 130 ]] || fail "an interrupted run ended with $code"
expect_code 0 "$opaline" check-data one

expect_code 2 "$opaline" render tiny.toml --out one --set render.bump=0.1
grep -q "another config" err.txt || fail "message about another config: $(cat err.txt)"
expect_code 2 "$opaline" render tiny.toml --out bad --set render.familes=1
grep -q 'render.families' err.txt || fail "message about an unknown key: $(cat err.txt)"
expect_code 2 "$opaline" render missing.toml --out bad
expect_code 2 "$opaline" render tiny.toml
[[ ! -e bad ]] || fail "a refused config left a folder behind"

expect_code 0 "$opaline" validate slab --albedo 0.9 --g 0.75 --tau 2 --n 1 --paths 20000 --json
python3 - <<'END' || fail "JSON of validate slab: $(cat out.txt)"
import json
r = json.load(open("out.txt"))
assert set(r) == {"Rd", "Rd_se", "T", "T_se", "specular", "paths_per_s"}, r
assert abs(r["Rd"] - 0.09739) < 4 * r["Rd_se"] < 0.02, r
assert abs(r["T"] - 0.66096) < 4 * r["T_se"] < 0.02, r
END
expect_code 0 "$opaline" validate slab --albedo 0.5 --tau inf --n 1 --incidence lambertian --paths 1000
expect_code 2 "$opaline" validate slab --albedo 1 --tau inf
expect_code 2 "$opaline" validate slab --albedo 0.5 --tau thick
expect_code 0 "$opaline" validate fresnel --paths 20000
expect_code 0 "$opaline" validate furnace --scenes 1 --paths 5000
expect_code 0 "$opaline" validate furnace one --scenes 1 --number 2 --paths 5000
grep -q -- "-1-2 (" out.txt || fail "the furnace did not draw the data set's scene 2: $(cat out.txt)"
expect_code 0 "$opaline" validate furnace tiny.toml --scenes 1 --paths 5000
expect_code 2 "$opaline" validate furnace missing.toml
expect_code 0 "$opaline" validate hg --g 0.9 --paths 10000
expect_code 2 "$opaline" validate hg --g 1
expect_code 0 "$opaline" validate sh --rotations 0
expect_code 0 "$opaline" validate flash --paths 300000
expect_code 0 "$opaline" validate stress --only "cubes that share a face" --paths 2000
grep -q "lost 0 of" out.txt || fail "stress counts no leaks: $(cat out.txt)"
echo "render and validate behave"
