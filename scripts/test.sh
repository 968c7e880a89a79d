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

step() { printf '\n== %s  (%d s)\n' "$*" "$SECONDS"; }

step "packages"
./scripts/setup.sh

step "format"
git ls-files '*.cpp' '*.h' | xargs clang-format --dry-run -Werror

step "dependency direction"
python3 scripts/check_layers.py

if ! $quick; then
  # The engine, the parsers and the renderer under address and undefined-behaviour checks, without the tests that
  # need many paths or minutes; what shares data between threads under the thread checker. OpenMP's runtime is not built for
  # the latter, so only std::thread code runs there.
  step "address and undefined behaviour"
  cmake --preset asan >/dev/null
  programs=(test_core test_core_kernels test_core_ops test_nn test_data test_data_render test_fuzz)
  cmake --build --preset asan --target "${programs[@]}"
  for program in "${programs[@]}"; do
    echo "$program"
    UBSAN_OPTIONS=print_stacktrace=1 OMP_WAIT_POLICY=passive timeout 900 "build/asan/$program" '~[statistics]~[long]'
  done

  step "threads"
  cmake --preset tsan >/dev/null
  cmake --build --preset tsan --target test_data
  OMP_NUM_THREADS=1 timeout 900 build/tsan/test_data '[loader]'
fi

step "build, warnings as errors"
cmake --preset release >/dev/null
cmake --build --preset release

step "tests"
ctest --test-dir build/release -LE long --output-on-failure
