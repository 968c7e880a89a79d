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
grep -q "9 files verified" out.txt || fail "a fresh set was not verified: $(cat out.txt)"
[[ -s one/contact_sheet.png ]] || fail "no contact sheet"
expect_code 0 "$opaline" render tiny.toml --out two --threads 3
for file in one/scenes/*.exr; do
  cmp "$file" "two/scenes/${file##*/}" || fail "$file depends on the number of threads"
done
cmp one/contact_sheet.png two/contact_sheet.png || fail "the contact sheet depends on the number of threads"
cut -d, -f1-3 one/train.jsonl > a; cut -d, -f1-3 two/train.jsonl > b
cmp a b || fail "the index depends on the number of threads"

# What is there is kept, what is gone comes back.
rm two/scenes/000002.exr
expect_code 0 "$opaline" render tiny.toml --out two
grep -q "1 scenes rendered, 8 kept" out.txt || fail "counts of a resumed set: $(cat out.txt)"
cmp one/scenes/000002.exr two/scenes/000002.exr || fail "a scene that was rendered again differs"

# Killed again and again at any moment, a run keeps what it finished and ends with the same set to the bit (but for
# the time that each scene took).
same_set() {  # same_set A B: but for the seconds of the index and the lock
  for name in train.jsonl test.jsonl; do
    cmp <(sed 's/,"seconds":[^}]*//' "$1/$name") <(sed 's/,"seconds":[^}]*//' "$2/$name") || return 1
  done
  diff -r -x lock -x '*.jsonl' "$1" "$2"
}
many=(--set render.train=50 --set render.test=10 --set render.spp=9)
expect_code 0 "$opaline" render tiny.toml --out whole "${many[@]}"
killed=0
for _ in 1 2 3 4 5 6; do
  printf -v delay "0.%02d" $((2 + RANDOM % 40))
  [[ -d killed ]] && find killed -name '*.exr' -printf '%f %T@\n' | sort > before.txt || : > before.txt
  listed=$(cat killed/*.jsonl 2> /dev/null | grep -oE '[0-9]{6}\.exr.*"seconds":[^}]*}$' | cut -c1-10 | sort) || true
  code=0
  timeout --signal=KILL "$delay" "$opaline" render tiny.toml --out killed "${many[@]}" --threads 1 > /dev/null 2>&1 || code=$?
  if [[ $code -eq 137 ]]; then killed=$((killed + 1)); fi
  for file in $listed; do
    grep -qF "$(grep "^$file" before.txt)" <(find killed -name '*.exr' -printf '%f %T@\n') \
      || fail "$file was finished and rendered again, after a kill at $delay s"
  done
done
[[ $killed -ge 1 ]] || fail "no run was killed before its end"
touch killed/scenes/000001.exr.tmp.77 killed/train.jsonl.tmp.77  # as a killed write leaves them
expect_code 0 "$opaline" render tiny.toml --out killed "${many[@]}"
grep -q "60 files verified" out.txt || fail "nothing was verified: $(cat out.txt)"
same_set whole killed || fail "a killed run ended with another set"
[[ -z "$(find killed -name '*.tmp.*')" ]] || fail "half-written files were left"

# Another process in the same folder is refused, and does no harm.
"$opaline" render tiny.toml --out stopped --set render.train=400 --set render.spp=16 > /dev/null 2>&1 & pid=$!
for _ in $(seq 200); do
  if [[ -s stopped/train.jsonl ]]; then break; fi
  sleep 0.05
done
expect_code 1 "$opaline" render tiny.toml --out stopped --set render.train=400 --set render.spp=16
grep -q "process $pid is rendering into this folder" err.txt || fail "message about the lock: $(cat err.txt)"

# An interrupted run says so in its exit code.
kill -INT $pid
code=0; wait $pid || code=$?
[[ $code -eq 130 ]] || fail "an interrupted run ended with $code"
expect_code 0 "$opaline" check-data one

# No room on the disk (here: for files over 12 KiB): loud, and what is finished stays.
code=0
(trap '' XFSZ; ulimit -f 12; exec "$opaline" render tiny.toml --out full "${many[@]}") > out.txt 2> err.txt || code=$?
[[ $code -eq 1 ]] || fail "a full disk ended with $code"
grep -q "full/" err.txt || fail "message about a full disk: $(cat err.txt)"
finished=$(cat full/*.jsonl | wc -l)
[[ $finished -ge 1 ]] || fail "nothing was finished before the disk was full"
expect_code 0 "$opaline" render tiny.toml --out full "${many[@]}"
grep -q " $finished kept" out.txt || fail "a full disk lost scenes: $finished listed, $(cat out.txt)"
same_set whole full || fail "a full disk changed the set"
touch file
expect_code 1 "$opaline" render tiny.toml --out file/set

# A damaged file is found at the end of a run, and made again.
printf x | dd of=full/scenes/000003.exr bs=1 seek=900 conv=notrunc status=none
expect_code 0 "$opaline" render tiny.toml --out full "${many[@]}"
grep -q "1 damaged files were rendered again" out.txt || fail "a damaged file was not found: $(cat out.txt)"
same_set whole full || fail "a damaged file came back otherwise"

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
