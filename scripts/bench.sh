#!/usr/bin/env bash
# Times the engine beside its peers, which take turns with it: single convolutions beside oneDNN, the networks beside
# PyTorch, all with their errors or memory; then networks over sizes and threads, memory over batches, single layers.
# Draws docs/images/net-normal.svg, roofline.svg and convolutions.svg. About an hour on two cores; nothing else should run.
#   scripts/bench.sh           everything
#   scripts/bench.sh --quick   one network and one size
# Threads: OMP_NUM_THREADS (default: all cores).
set -euo pipefail
cd "$(dirname "$0")/.."

quick=0
if [[ "${1:-}" == "--quick" ]]; then
  quick=1
elif [[ $# -gt 0 ]]; then
  echo "usage: scripts/bench.sh [--quick]" >&2
  exit 2
fi

./scripts/setup.sh
./scripts/setup.sh --peers
cmake --preset release -DOPALINE_BUILD_BENCH=ON >/dev/null
cmake --build --preset release --target opaline bench_onednn bench_ops >/dev/null

threads=${OMP_NUM_THREADS:-$(nproc)}
peer=(bench/peers/step_pytorch.py --threads "$threads")
build/release/bench_onednn --threads "$threads" --plot docs/images/convolutions.svg
echo
if [[ $quick -eq 1 ]]; then
  "${peer[@]}" --net normal --size 64 --batch 8
  exit 0
fi
"${peer[@]}" --net normal sss illumination stage1 stage2
echo
"${peer[@]}" --net normal stage1 stage2 --environment default
echo
"${peer[@]}" --net cascade --forward --batch 1
echo
"${peer[@]}" --net stage2 --numerics strict
echo
"${peer[@]}" --net normal stage1 --size 64 --batch 32
echo
"${peer[@]}" --net normal stage1 --width 16
echo
counts=(1)
[[ $threads -eq 1 ]] || counts+=("$threads")
opaline=build/release/opaline
"$opaline" bench net --net normal --size 64 128 256 512 --threads "${counts[@]}" --plot docs/images/net-normal.svg
echo
for net in sss illumination; do  # whose norms over vectors have useful gradients from a few images on only
  "$opaline" bench net --net "$net" --batch 4 --size 64 128 256 --threads "${counts[@]}"
  echo
done
for net in stage1 stage2 cascade; do
  "$opaline" bench memory --net "$net" --batch 2 4
  echo
done
"$opaline" bench skip --net stage2 --plot docs/images/skip.svg
echo
for net in normal sss; do
  "$opaline" bench skip --net "$net"
  echo
done
"$opaline" bench skip --net cascade --forward
echo
build/release/bench_ops --threads "$threads"
echo
"$opaline" bench layers --net normal --size 128 --plot docs/images/roofline.svg
for net in illumination sss reconstruction; do
  "$opaline" bench layers --net "$net" --size 128
done
