#!/usr/bin/env bash
# Everything that has to hold before a change lands: format, dependency direction, sanitizers, then the tests.
#   scripts/test.sh            all of it
#   scripts/test.sh --quick    without the sanitizer builds
set -euo pipefail
cd "$(dirname "$0")/.."

quick=false
case "${1:-}" in
  "") ;;
  --quick) quick=true ;;
  *) echo "usage: scripts/test.sh [--quick]" >&2; exit 2 ;;
esac

step() { printf '\n== %s\n' "$*"; }

step "packages"
./scripts/setup.sh

step "format"
git ls-files '*.cpp' '*.h' | xargs clang-format --dry-run -Werror

step "dependency direction"
python3 scripts/check_layers.py

if ! $quick; then
  # The parsers and the engine under address and undefined-behaviour checks; what shares data between threads
  # under the thread checker. OpenMP's runtime is not built for the latter, so only std::thread code runs there.
  step "address and undefined behaviour"
  cmake --preset asan >/dev/null
  cmake --build --preset asan --target test_core test_core_ops test_nn test_data test_data_render
  UBSAN_OPTIONS=print_stacktrace=1 ctest --test-dir build/asan --output-on-failure -R '^(core|core/ops|nn|data|data/render)$' \
    -E none --timeout 900

  step "threads"
  cmake --preset tsan >/dev/null
  cmake --build --preset tsan --target test_data
  OMP_NUM_THREADS=1 build/tsan/tests/test_data '[loader]'
fi

step "build, warnings as errors"
cmake --preset release >/dev/null
cmake --build --preset release

step "tests"
ctest --test-dir build/release --output-on-failure
