#!/usr/bin/env bash
# Installs what opaline needs from Debian 12's packages. Does nothing, and needs no rights, where all is there.
#   scripts/setup.sh            build, test and run
#   scripts/setup.sh --peers    also what the comparisons with PyTorch and Mitsuba need
#   scripts/setup.sh --fuzz     also what the libFuzzer programs need (tests/fuzz/CMakeLists.txt)
set -euo pipefail

packages=(
  g++ cmake ninja-build ccache git pkg-config python3
  clang-format clang-tidy
  libeigen3-dev libopenexr-dev libimath-dev libpng-dev libtomlplusplus-dev libcli11-dev nlohmann-json3-dev
  libfmt-dev libspdlog-dev libxxhash-dev libembree-dev libhwy-dev catch2
)
if [[ "${1:-}" == "--peers" ]]; then
  # OpenBLAS: with the reference BLAS that PyTorch would pull in, the comparison takes three times as long.
  packages+=(python3-torch python3-numpy python3-pil libopenblas0-pthread libdnnl-dev)
  # Mitsuba itself comes from PyPI into a virtual environment (bench/peers/mitsuba_render.py); it compiles with LLVM,
  # and refuses 14 and stumbles over 15.
  packages+=(python3-venv libllvm19)
elif [[ "${1:-}" == "--fuzz" ]]; then
  packages+=(clang libclang-rt-14-dev libomp-dev)
elif [[ $# -gt 0 ]]; then
  echo "usage: scripts/setup.sh [--peers | --fuzz]" >&2
  exit 2
fi

missing=()
for package in "${packages[@]}"; do
  [[ "$(dpkg-query -W -f='${Status}' "$package" 2>/dev/null)" == "install ok installed" ]] || missing+=("$package")
done
if [[ ${#missing[@]} -eq 0 ]]; then
  exit 0
fi

echo "setup: installing ${missing[*]}"
run=()
if [[ $(id -u) -ne 0 ]]; then
  run=(sudo)
fi
"${run[@]}" apt-get update -qq
DEBIAN_FRONTEND=noninteractive "${run[@]}" apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
