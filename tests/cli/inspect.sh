#!/usr/bin/env bash
# inspect and check-data from the command line: what they print and how they exit.
set -euo pipefail
opaline=$1
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT

expect() {  # expect CODE COMMAND...
  local wanted=$1 got=0
  shift
  "$@" >"$folder/out" 2>"$folder/err" || got=$?
  if [[ $got -ne $wanted ]]; then
    echo "exit $got, expected $wanted: $*"
    cat "$folder/out" "$folder/err"
    exit 1
  fi
}
says() {  # says FILE TEXT
  grep -qF -- "$2" "$folder/$1" || { echo "no '$2' in:"; cat "$folder/$1"; exit 1; }
}

# A 2 x 1 npy of float32: 1.5 and -2.
{ printf '\x93NUMPY\x01\x00\x46\x00'
  printf '%-69s\n' "{'descr': '<f4', 'fortran_order': False, 'shape': (2, 1), }"
  printf '\x00\x00\xc0\x3f\x00\x00\x00\xc0'; } >"$folder/a.npy"
expect 0 "$opaline" inspect "$folder/a.npy"
says out 'shape (2, 1)'
says out 'min -2'
says out 'max 1.5'

head -c 80 "$folder/a.npy" >"$folder/b.npy"
expect 1 "$opaline" inspect "$folder/b.npy"
says err 'b.npy'

expect 2 "$opaline" inspect "$folder/missing.npy"
says err 'missing.npy'
expect 2 "$opaline" inspect
expect 1 "$opaline" check-data "$folder"
says err 'holds no data set'
expect 0 "$opaline" check-data --help

# A capture with three of its four angles.
mkdir "$folder/capture"
printf 'not a png' >"$folder/capture/p0.png"
expect 1 "$opaline" check-data "$folder/capture"
says err 'p0.png'
