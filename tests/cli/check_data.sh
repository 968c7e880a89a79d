#!/usr/bin/env bash
# `opaline check-data` on a rendered set and on broken copies of it: what it prints and how it exits.
set -euo pipefail
opaline=$1
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work"

fail() { echo "FAILED: $*" >&2; cat out.txt err.txt >&2; exit 1; }
expect_code() {
  local expected=$1 code=0
  shift
  "$@" > out.txt 2> err.txt || code=$?
  [[ $code -eq $expected ]] || fail "exit code $code instead of $expected: $*"
}
says() { grep -qE -- "$1" out.txt || fail "no '$1' in the output"; }
broken() {  # broken: a fresh copy of the set
  rm -rf copy
  cp -r set copy
}

cat > set.toml <<'END'
[render]
train = 8
test = 3
size = 32
spp = 4
photons = 500
END
expect_code 0 "$opaline" render set.toml --out set

expect_code 0 "$opaline" check-data set --html set.html --json set.json --contact-sheet set.png
says 'good +files +11 of 11'
says 'good +I0 \+ I90 = I45 \+ I135'
says 'good +signs of s1 and s2'
says 'good +normals and depth'
says 'good +objects of the splits'
says '^0 problems, 0 warnings'
grep -q '</html>' set.html || fail "no page"
grep -q 'data:image/png' set.html || fail "a page without images"
cmp set.png set/contact_sheet.png || fail "another contact sheet than the renderer's"
python3 - <<'END' || fail "the JSON"
import json
check = json.load(open("set.json"))
assert check["sound"] and check["layout"] == "opaline", check
assert len(check["splits"]["train"]) == 8 and len(check["splits"]["test"]) == 3
assert all(f["verdict"] in ("good", "undecided") for f in check["findings"]), check["findings"]
END
expect_code 0 "$opaline" inspect set
expect_code 0 "$opaline" inspect set/scenes/000000.exr

# A flipped bit, a short file, a missing one.
broken
printf '\x55' | dd of=copy/scenes/000004.exr bs=1 seek=2000 conv=notrunc status=none
truncate -s -9 copy/scenes/000002.exr
rm copy/scenes/000009.exr
expect_code 1 "$opaline" check-data copy --html copy.html
says 'BAD +files +8 of 11'
says 'train scene 000004: .*000004.exr.*checksum'
says 'train scene 000002'
says 'test scene 000009'
says '^3 problems'
grep -q 'cannot be read' copy.html || grep -q '000004.exr' copy.html || fail "the page hides damage"

# Signs that are not as declared.
broken
sed -i 's/^s2 = "I45 - I135"/s2 = "I135 - I45"/' copy/dataset.toml
expect_code 1 "$opaline" check-data copy
says 'BAD +signs of s1 and s2 +.*s2 has the wrong sign'

# An id twice, a parameter out of range, a scene too few.
broken
sed -i '2s/"id":"000001"/"id":"000000"/' copy/train.jsonl
expect_code 1 "$opaline" check-data copy
grep -q 'train.jsonl.*lists scene 000000 twice' err.txt || fail "an id twice"
broken
sed -i '1s/"flash":[0-9.]*/"flash":90.5/' copy/train.jsonl
expect_code 0 "$opaline" check-data copy
says 'flash is 90.5, outside'
broken
sed -i '1d' copy/test.jsonl
expect_code 1 "$opaline" check-data copy
says 'promises 3 test scenes, test.jsonl lists 2'

expect_code 2 "$opaline" check-data
expect_code 1 "$opaline" check-data missing
expect_code 1 "$opaline" check-data set --html missing/page.html
grep -q 'missing/page.html' err.txt || fail "a page that cannot be written"
echo "check-data behaves"
